"""The words for what a model may lack: one file per effect with its meaning, parameters, units and ranges.

Two rooms give these words equations of their own, `leactl.effects` for diagnosis and simulation and
`leactl.emulation.plant.effects` for the emulated bench, and share nothing but the definitions here.
"""
