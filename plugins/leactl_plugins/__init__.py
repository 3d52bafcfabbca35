"""Driver plug-ins that ship with leactl; each is found by its entry point, as third-party ones are."""
