"""Files of other programs as sources of columns, one reader for each format."""
