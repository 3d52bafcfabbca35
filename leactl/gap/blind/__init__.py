"""The check on withheld causes: every case answered with the key shut, then each answer beside the truth."""
