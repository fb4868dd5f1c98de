"""Files, locks, memory, signals and threads."""
