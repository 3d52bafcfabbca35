"""The two emulated plants, exact and stepped, with their effects, terminals and loads."""
