"""Where model and bench disagree, which unmodelled effect causes it, and how far the gap shrinks with it."""
