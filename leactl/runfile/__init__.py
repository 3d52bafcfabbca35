"""Write, read and check run files: one HDF5 file holds one run.

A kill at any moment loses at most the last unflushed second, no file is ever overwritten, and plain h5py, xarray and
MATLAB open run files.

    write/      record a run: rows into memory, memory into a live file, at the end the compressed file
    read/       read channels, steps, events and notes of a run
    verify/     check, recover, annotate and convert run files
    importing/  convert recordings of other programs to run files, as a mapping states
    attach.py   add the record of another device to a closed run
    export.py   write CSV, MATLAB and Parquet files
    catalog/    list the runs of a folder: summaries, index, tags, selection
    align/      find the offset and drift between two clocks from signals recorded on both
    hdf5/       open HDF5 files of unknown origin safely

`layout` (names of groups and attributes), `seal` (digests), `summary`, `publish` (write whole files or none) and
`instruments` are shared by these packages.
"""
