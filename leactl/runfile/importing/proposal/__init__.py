"""Propose a mapping for a file that nobody has described (`--map auto`)."""
