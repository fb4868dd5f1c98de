"""Setting finished runs side by side, and beside published numbers."""
