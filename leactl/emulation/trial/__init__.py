"""Trials of a driver on its own far end: its readings, setpoints and end are compared with the truth."""
