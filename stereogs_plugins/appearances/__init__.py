"""Appearances: what a photograph does to the colours that the scene has."""
