"""The commands: one file a noun, each parses, calls and prints. What a command needs is imported when it runs."""
