"""Drill of a bench: cause faults and stops on purpose, and judge whether each run ends in a safe state."""
