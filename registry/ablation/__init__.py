"""Ablation: one pipeline with its parts on and off and its settings varied, trained and compared.

description.py, arguments.py   what to ablate, as an ablation file and the command line say it
toggles.py                     what "off" means for each part
variations.py, scenes.py       what takes several values, and what is trained on
plan.py, planning.py           every combination, scene and seed as a checked pipeline
runner.py, jobs.py             the plan's runs, each a `stereogs train` in a process of its own
folder.py                      where runs lie, and which of them are finished
scores.py                      what the runs measured, averaged
table.py, page.py, plots.py    the numbers as text, CSV and one HTML page
"""
