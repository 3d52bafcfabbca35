"""What may be said of a set of effects: probabilities, held-out gaps, where they show, what is left unexplained."""
