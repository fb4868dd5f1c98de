"""The verbs `ablate`, `bench` and `compare`.

planning/    the runs of an ablation or bench: combinations, scenes, seeds
running/     train many runs with a runner, by default each in its own process; `benchmarks/` too
showing/     their results as text, CSV and an HTML page; `score_table` writes all tables
comparing/   compare finished runs with each other and with published numbers
"""
