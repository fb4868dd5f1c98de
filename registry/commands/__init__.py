"""One file a verb of the command line. Each has `add(verbs)`, which names its `run(arguments)`."""
