"""Bench YAML to opened devices, calibrated channels and a clock."""
