"""Modifiers: what a training render leaves out."""
