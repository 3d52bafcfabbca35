"""The plant of many benches at once in fixed sub-steps, with every effect of the vocabulary."""
