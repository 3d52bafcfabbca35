"""What Elmo's drives have in common, whatever wire they are on: scales, positions, names of faults and errors."""
