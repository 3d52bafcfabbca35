"""The effect library: what a nominal model may lack, as equations for diagnosis and simulation, one file per effect."""
