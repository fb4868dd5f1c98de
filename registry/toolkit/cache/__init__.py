"""What was computed once, on disk, found again by the content of the question.

    from registry import cache

    kept = cache.Cache("flows")
    key = cache.content_key(image, other, settings.model_dump_json(), cache.source_digest(estimate))
    flow = kept.load(key, read)             None: not there, or damaged
    if flow is None:
        flow = estimate(image, other)
        kept.save(key, lambda folder: write(flow, folder))

An entry is a folder that is whole or absent. All kinds of entries share one folder and one bound on its
size: what was not used for the longest time goes first. Deleting any of it is safe.
"""

from .entries import Cache
from .keys import content_key, source_digest
from .place import FOLDER_VARIABLE, SIZE_VARIABLE, cache_folder, size_limit

__all__ = [
    "FOLDER_VARIABLE",
    "SIZE_VARIABLE",
    "Cache",
    "cache_folder",
    "content_key",
    "size_limit",
    "source_digest",
]
