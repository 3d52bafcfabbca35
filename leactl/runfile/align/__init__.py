"""Find the offset and drift between two clocks from signals that were recorded on both."""
