"""Mutants: copies of the code with one place changed, which the tests of that place must notice.

`make mutants` runs a seeded sample of them and prints how many were killed, that is, failed a test.

It is own code because the mutants include OpenCL kernels, and each file has its own tests.
"""
