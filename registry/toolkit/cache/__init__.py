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

from typing import TYPE_CHECKING

from core_rasterizer.first_use import names_on_first_use

if TYPE_CHECKING:
    from .entries import Cache as Cache
    from .keys import content_key as content_key, source_digest as source_digest
else:
    __all__, __dir__, __getattr__ = names_on_first_use(__name__)
