"""Whether the printed intervals hold the true values as often as they say: `python -m tests.coverage_of_intervals`."""
