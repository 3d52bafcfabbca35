"""Check that run files are as they were when they were closed, and repair, annotate or convert them."""
