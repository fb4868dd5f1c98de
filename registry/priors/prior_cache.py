"""Cache of estimates on disk, and the digest of the code that computes them.

    STEREOGS_CACHE/<prior>/<key>/answer.safetensors   the tensors, bit for bit
                                 answer.json          the inputs, human-readable
                                 *.png                images of the estimate

The key is a hash of all bits of the input, the settings, the prior's fingerprint, and all code of the
packages that compute the estimate: any changed line of code invalidates the entry.
"""

from __future__ import annotations

import hashlib
from collections.abc import Mapping
from functools import cache
from importlib.metadata import Distribution, entry_points
from importlib.util import find_spec
from pathlib import Path
from typing import TYPE_CHECKING, Any

from ..plugins.discovery import GROUP
from ..system.files import write_json
from ..toolkit.cache import Cache, content_key
from ..toolkit.drawing.pictures import save_png

if TYPE_CHECKING:
    from torch import Tensor

_ANSWER = "answer.safetensors"
_SOURCES = (".py", ".cl")


class PriorCache:
    """Estimates of one prior.

    Args:
        prior: Name of the prior.
    """

    def __init__(self, prior: str) -> None:
        self._cache = Cache(prior)

    def load(self, key: str) -> dict[str, Tensor] | None:
        """Return the tensors saved under a key, or None."""
        from safetensors.torch import load_file

        return self._cache.load(key, lambda folder: load_file(folder / _ANSWER))

    def save(
        self,
        key: str,
        tensors: Mapping[str, Tensor],
        pictures: Mapping[str, Tensor],
        facts: Mapping[str, Any],
    ) -> None:
        """Save an estimate.

        Args:
            pictures: `[H, W, 3]` in [0, 1] by file name without suffix.
            facts: Description of the inputs, for answer.json.
        """
        from safetensors import SafetensorError
        from safetensors.torch import save_file

        def write(folder: Path) -> None:
            try:
                save_file(dict(tensors), folder / _ANSWER)
            except SafetensorError as error:  # for example on a full disk
                raise OSError(str(error)) from error
            write_json(folder / "answer.json", {"key": key, **facts})
            for name, picture in pictures.items():
                save_png(picture, folder / f"{name}.png")

        self._cache.save(key, write)


def code_digest(component: type) -> str:
    """Return a hash of the source of the component's package, the host and the engine."""
    modules = {*owned_modules(component.__module__), "registry", "core_rasterizer"}
    return content_key(
        component.__qualname__,
        component.__module__,
        *(source_digest(name) for name in sorted(modules)),
    )


def owned_modules(module: str) -> frozenset[str]:
    """Return the top-level modules of the plugin package of a module; its own for other packages."""
    top = module.partition(".")[0]
    for package in {id(e.dist): e.dist for e in entry_points(group=GROUP)}.values():
        names = _top_level(package) if package else frozenset[str]()
        if top in names:
            return names
    return frozenset((top,))


def _top_level(package: Distribution) -> frozenset[str]:
    """Return the top-level modules of a package, from setuptools' list or from its list of files."""
    listed = package.read_text("top_level.txt")
    if listed is not None:
        return frozenset(listed.split())
    files = [file for file in package.files or () if file.suffix == ".py"]
    return frozenset(file.parts[0].removesuffix(".py") for file in files)


@cache
def source_digest(name: str) -> str:
    """Return a hash of a top-level module, or of all source files of a package."""
    spec = find_spec(name) if name != "__main__" else None
    folders = list(spec.submodule_search_locations or ()) if spec else []
    if spec and not folders and spec.origin:
        return hashlib.sha256(Path(spec.origin).read_bytes()).hexdigest()
    digest = hashlib.sha256(name.encode())
    for folder in map(Path, folders):
        for path in sorted(p for p in folder.rglob("*") if p.suffix in _SOURCES):
            digest.update(str(path.relative_to(folder)).encode() + b"\0" + path.read_bytes())
    return digest.hexdigest()
