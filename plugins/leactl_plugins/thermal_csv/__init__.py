"""Thermal cameras by the text files that their programs export."""
