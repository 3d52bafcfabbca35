"""Campaigns: many runs in order, from a file of protocols and conditions to a folder of run files."""
