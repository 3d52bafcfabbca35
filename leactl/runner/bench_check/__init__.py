"""Check a bench file on its bench: identities and readings of its devices at rest, and how its shaft turns."""
