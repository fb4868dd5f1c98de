"""Observers: log the progress of a run to experiment trackers."""
