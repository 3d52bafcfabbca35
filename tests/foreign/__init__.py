"""Drivers against far ends, and emulators against masters, that nobody of this project wrote."""
