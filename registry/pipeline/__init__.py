"""Pipelines: read from YAML, checked, changed, and their components built."""
