"""Protocol files that ship with leactl."""
