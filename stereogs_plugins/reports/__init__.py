"""Reports: pages about a finished run."""
