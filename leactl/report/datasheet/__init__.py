"""A datasheet of actuators from their runs: what was measured, how surely and from what, beside the paper's figures."""
