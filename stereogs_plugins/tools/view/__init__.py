"""A scene in the browser, rendered here and shown there, through the package viser (extra `viewer`)."""
