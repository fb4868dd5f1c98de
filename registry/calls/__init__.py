"""Checks around every call into a plugin: duration, memory, and state that it must not change."""
