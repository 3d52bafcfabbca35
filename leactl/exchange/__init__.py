"""Joints of other simulators: read from MJCF and URDF as model files, augmented models written back.

MuJoCo comes with `pip install 'leactl[mujoco]'` (Apache-2.0); it compiles each file, so that defaults, includes and
bodies count as they do in the user's simulation.
"""
