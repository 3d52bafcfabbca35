"""The plant that is stepped exactly between events: piecewise linear."""
