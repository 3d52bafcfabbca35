"""A driver tried on its own far end: its readings, setpoints and end are held against what is true there."""
