"""A run's page in a browser: `leactl run --web`."""
