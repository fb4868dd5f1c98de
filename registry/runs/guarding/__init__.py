"""What guards a run at work: a Ctrl-C that waits for an iteration, a lock against other processes."""
