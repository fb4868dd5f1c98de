"""Metrics: scores of a rendered view against its photograph."""
