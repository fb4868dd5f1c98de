"""Train many planned runs with a runner, by default each in its own process."""
