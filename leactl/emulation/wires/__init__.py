"""Buses and lines on which the far ends answer, in this process and for others."""
