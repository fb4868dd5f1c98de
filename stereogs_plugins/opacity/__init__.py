"""Opacity policies: resets and decays."""
