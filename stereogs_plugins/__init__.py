"""The plugins that come with the project: one file a plugin, one folder a hook point.

They use the same public interfaces, `registry` and `core_rasterizer`, as anybody's plugin, and are
found in the same way, through the `stereogs.plugins` entry points. None imports another.
"""
