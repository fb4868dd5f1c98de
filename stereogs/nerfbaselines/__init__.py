"""Pipelines as methods of NerfBaselines, and the protocols as its data sets."""
