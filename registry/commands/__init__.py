"""One file a verb of the command line. Each has `add(verbs)`, which names its `run(arguments)`.

At its top a verb imports what its options need; what its work needs, `run` imports.
"""
