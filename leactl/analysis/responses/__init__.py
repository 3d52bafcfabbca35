"""Responses of control loops, to steps and to noise: records of them, frequency responses, step metrics."""
