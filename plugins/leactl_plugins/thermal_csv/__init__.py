"""Driver for thermal cameras, read from the text files that their programs export."""
