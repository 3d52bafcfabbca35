"""Runs as the equations need them: channels on even clocks, with their noise, stamps and scales."""
