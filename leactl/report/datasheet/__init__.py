"""Datasheets of actuators from their runs: results with uncertainties and sources, beside the figures of the paper."""
