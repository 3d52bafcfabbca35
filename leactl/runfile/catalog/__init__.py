"""List the runs of a folder: their summaries, an index of these, tags, and the selection by conditions."""
