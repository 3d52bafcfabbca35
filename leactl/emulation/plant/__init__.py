"""The two emulated plants, exact and stepped, and what hangs at them."""
