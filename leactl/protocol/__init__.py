"""YAML to a checked, fully expanded plan; what a bench will do, known before it moves."""
