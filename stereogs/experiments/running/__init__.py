"""Train planned runs, each in its own process."""
