"""Elmo Gold servo drives over CANopen."""
