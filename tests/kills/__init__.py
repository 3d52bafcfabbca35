"""Runs that are killed or hung while current flows: `python -m tests.kills`."""
