"""Cases for a test on withheld causes: benches with an unknown departure from their nominal model, and their key."""
