"""Checks of the results of components and scene loaders."""
