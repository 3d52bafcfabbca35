"""The drill: what a bench does when something goes wrong, tried on purpose and judged."""
