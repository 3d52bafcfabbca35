"""Text tables of other programs: encoding, delimiter, headings, numbers and the order of the rows.

Settings decide first; what they leave out is detected, and a file with two readings is refused.
"""
