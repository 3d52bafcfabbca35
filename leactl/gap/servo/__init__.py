"""Pendulums on position servos: simulated many at once, and effects judged by how closely a free run then follows."""
