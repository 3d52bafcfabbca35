"""An emulated bench behind a bench file."""
