"""Record a run: rows into memory, memory into a live file, and at the end the compressed file with checksums."""
