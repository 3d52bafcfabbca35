"""Read a run: channels by quantity and role, steps, events and notes."""
