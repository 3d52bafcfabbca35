"""From runs to results with uncertainties: one file an experiment, pure functions, nothing acquired."""
