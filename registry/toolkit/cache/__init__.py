"""Cache results on disk under a hash of their inputs.

    from registry.toolkit.cache import Cache, content_key, source_digest

    cache = Cache("flows")
    key = content_key(image, other, settings.model_dump_json(), source_digest(estimate))
    flow = cache.load(key, read)             None if missing or damaged
    if flow is None:
        flow = estimate(image, other)
        cache.save(key, lambda folder: write(flow, folder))

An entry is a folder that is either complete or absent. All kinds share one folder with one size limit; the
least recently used entries are removed first. It is safe to delete any of them.
"""

from .entries import FOLDER_VARIABLE, Cache
from .keys import code_digest, content_key, package_digest, source_digest

__all__ = [
    "FOLDER_VARIABLE",
    "Cache",
    "code_digest",
    "content_key",
    "package_digest",
    "source_digest",
]
