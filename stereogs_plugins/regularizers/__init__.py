"""Regularizers: loss terms added to the photometric loss."""
