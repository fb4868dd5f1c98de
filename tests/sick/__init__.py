"""Components with one fault each, made from templates, and what the host says about them.

`make sick` prints the table. `tests/registry/faulty.py` holds packages that are installed; these are not.
Tests of `registry.testing`, which import its modules.
"""
