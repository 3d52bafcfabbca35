"""Cases for a check on withheld causes: benches with an unknown departure from their nominal model, and a key apart."""
