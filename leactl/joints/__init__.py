"""Drawn machines for the blind test: free joints of many sizes, simulated by two programs that share no equation.

A machine is drawn with its sampling rate, channels, protocols and noise. Each case is a specimen of one machine. The
emulated bench is no part of this package, and neither is the diagnosis.
"""
