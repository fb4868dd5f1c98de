"""Ablation: one pipeline with its parts on and off and its settings varied, trained and compared.

planning/   from an ablation file and the command line to every combination, scene and seed
running/    the plan's runs, each a `stereogs train` in a process of its own, and where they lie
showing/    what the runs measured, averaged: as text, CSV and one HTML page
"""
