"""OpenCL runtimes besides the installed one, fetched into build/runtimes, and the engine's tests on each.

Tests of `core_rasterizer`, which import its modules.
"""
