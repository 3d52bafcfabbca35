"""Common parts of the drivers of Elmo drives: scales, positions, names of faults and errors."""
