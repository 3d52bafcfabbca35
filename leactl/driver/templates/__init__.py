"""Templates of a package with one driver; `$name` and the like stand for what `leactl driver new` was given."""
