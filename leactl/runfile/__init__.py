"""Run files: one HDF5 file holds one run, written while the bench moves and read years later by anyone.

A kill at any moment loses at most the last unflushed second, nothing is ever overwritten, and plain h5py, xarray and
MATLAB open what is written here. `writer` records, `reader` opens and checks, `integrity` verifies, recovers and
annotates, `export` and `catalog` serve people; `layout`, `repack` and `publish` are what these five share.
"""
