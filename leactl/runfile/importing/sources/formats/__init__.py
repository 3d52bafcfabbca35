"""The shipped formats of foreign files, one file each: a module here with `ENDINGS` and `open_source` is a format."""
