"""Characterise electric actuators on a bench: protocols in, HDF5 runs and fitted parameters out."""

__version__ = "0.1.0"
