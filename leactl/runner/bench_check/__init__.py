"""Whether a bench file tells the truth: what devices say and read at rest, and how its shaft turns."""
