"""OpenCL runtimes besides the installed one, fetched into build/runtimes, and the engine's tests on each."""
