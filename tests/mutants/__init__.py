"""Mutants: copies of the code with one place changed, which the tests of that place must notice.

`make mutants` runs a seeded sample of them and prints how many were killed, that is, failed a test.

mutmut and cosmic-ray know no OpenCL, and run one set of tests for all files.
"""
