"""Modifiers: scale opacities in training renders."""
