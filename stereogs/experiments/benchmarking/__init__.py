"""Scores at equal time, of pipelines and of other programs, for the verb `benchmark`.

description.py  the benchmark file, and the trials that it lists
programs/       command lines of other programs
trial.py        one trial in its own process
other.py        the trial of another program
scoring.py      scores, and what a result must state
snapshots.py    the state of a training at each number of seconds
keeping.py      the folder of the trials, and their records
tables.py       budget table, differences, noise floor and costs
"""
