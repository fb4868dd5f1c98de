"""Appearances: per-photograph colour transforms."""
