"""Regressions, means of trials and intervals, of numbers that know nothing of a bench."""
