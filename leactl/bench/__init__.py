"""Benches: a bench file becomes opened devices, calibrated channels and a clock."""
