"""Runs of a simulator in the place of the model: what it contains, and what the real runs have beyond it."""
