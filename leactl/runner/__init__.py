"""One loop that executes a plan on a bench: pacing, the safety gate, recording, an orderly end."""
