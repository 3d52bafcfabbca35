"""Executes a plan on a bench: one loop for pacing, supervision and recording, and one orderly end for all of them."""
