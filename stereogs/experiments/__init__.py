"""The verbs `ablate`, `bench` and `compare`.

planning/    the runs of an ablation or bench: combinations, scenes, seeds
running/     train them, each with `stereogs train` in its own process
showing/     their results as text, CSV and an HTML page
comparing/   compare finished runs with each other and with published numbers
"""
