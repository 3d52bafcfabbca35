"""Limits, the thermal estimate, and the one supervisor through which every command passes."""
