"""Before any bench time: what runs or protocols can reveal of a model's gaps, and which experiment would show more."""
