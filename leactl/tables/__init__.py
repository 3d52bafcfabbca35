"""Text tables of other programs: encoding, delimiter, headings, numbers and the order of the rows.

Settings that are stated apply; the others are detected. A file that can be read in two ways is refused.
"""
