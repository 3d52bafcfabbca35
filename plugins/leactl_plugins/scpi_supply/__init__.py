"""Programmable DC supplies that speak SCPI over a serial line."""
