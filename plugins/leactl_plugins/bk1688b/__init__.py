"""BK Precision's switching supplies 1685B, 1687B and 1688B over their serial line."""
