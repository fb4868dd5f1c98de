"""Verbs: their base class, where they are found, and the arguments and output that several have."""
