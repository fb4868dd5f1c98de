"""Messages to users: suggestions, the terminal, and the command line's help."""
