"""Import recordings of other programs: a file and a mapping in, run files out."""
