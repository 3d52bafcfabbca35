"""How often the paper's verdicts over the bearing preloads come out, and false ones: `python -m tests.verdicts`."""
