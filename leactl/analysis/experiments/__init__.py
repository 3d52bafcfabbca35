"""The shipped experiments, one file each: a module here with `analyze` and `RESULTS` is an experiment by its name."""
