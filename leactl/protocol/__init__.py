"""Protocols: YAML files are checked and expanded to plans, which list every action before a bench moves."""
