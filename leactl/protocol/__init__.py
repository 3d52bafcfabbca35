"""Protocols: YAML files are checked and expanded to plans, which say before a bench moves what it will do."""
