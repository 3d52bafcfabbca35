"""Check that run files have not changed since they were closed, and recover, annotate or convert them."""
