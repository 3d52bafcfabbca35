"""Propose a mapping for a file that has none (`--map auto`)."""
