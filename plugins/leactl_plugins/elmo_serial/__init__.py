"""Elmo servo drives over RS-232, in the two-letter commands of their interpreter."""
