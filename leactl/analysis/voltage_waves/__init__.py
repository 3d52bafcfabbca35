"""Voltages of a turning motor with its leads open: pairs of leads, waves cut and averaged, harmonics, pole pairs."""
