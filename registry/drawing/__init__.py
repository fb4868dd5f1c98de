"""Pictures, films and camera flights."""
