"""Tie one clock to another by signals that were recorded on both."""
