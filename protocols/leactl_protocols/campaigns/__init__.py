"""Campaigns that ship with leactl, as package data: one YAML file each."""
