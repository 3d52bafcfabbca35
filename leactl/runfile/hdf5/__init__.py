"""Open HDF5 files of unknown origin: what their object headers announce is checked before HDF5 reads any value."""
