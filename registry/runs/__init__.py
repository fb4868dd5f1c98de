"""A run from its beginning to its results, and the folder that it leaves."""
