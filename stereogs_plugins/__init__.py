"""The plugins that come with the project: one folder a hook point; a plugin is a file
in it, or a folder if it has parts of its own.

They use the same public interfaces, `registry` and `core_rasterizer`, as anybody's plugin, and are
found in the same way, through the `stereogs.plugins` entry points. None imports another.
"""
