"""The emulated bench: plant, faults, and the far ends of the wires."""
