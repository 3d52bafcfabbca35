"""Packages with one driver, to begin with: texts with `$name` where the driver's own words go."""
