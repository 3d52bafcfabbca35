"""One regression with the columns of every effect in it, and the search for the small set that explains the runs."""
