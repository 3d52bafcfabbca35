"""List the runs of a folder: summaries, their index, tags, and which runs a person asks for."""
