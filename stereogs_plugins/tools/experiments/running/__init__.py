"""Training what was planned, each run in a process of its own."""
