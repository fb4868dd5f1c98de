"""Guesses where no two views agree: in holes, behind foreground edges, around each image."""
