"""Drawn machines: free joints of many sizes, simulated twice over by code that shares no equation, for the blind check.

A machine is drawn with what its users have of it: rate, channels, protocols, noise. Each case is a specimen of one. The
emulated bench is no part of this room, and neither is the diagnosis.
"""
