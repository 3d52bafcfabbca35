"""Judge the channels of a run before any analysis reads them: what a dead sensor says is no measurement."""
