"""Run files: write, read, verify, recover, annotate and export them."""
