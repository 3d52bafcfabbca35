"""How often the 95 % interval of an alignment holds the true offset, over simulated pairs of clocks."""
