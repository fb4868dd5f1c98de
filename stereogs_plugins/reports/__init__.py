"""Pages that show a finished run."""
