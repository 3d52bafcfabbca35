"""What leactl costs beside the bare library calls it cannot do without: `pytest tests/benchmarks`.

Each limit is a ratio to a named peer, measured in the same run, round by round in turn.
"""
