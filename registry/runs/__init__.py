"""A whole run and its folder: from the scene to scores, exports and reports."""
