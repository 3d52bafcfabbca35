"""The thermal guard: where the heat is, how hot a winding may be at most, and what it may still carry."""
