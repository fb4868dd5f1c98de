"""Answers of prior models on disk, found again by the content of the question.

    STEREOGS_CACHE/<prior>/<key>/answer.safetensors   the tensors, bit for bit
                                 answer.json          what was asked, for people
                                 *.png                the answer as pictures

The key is a hash over every bit of the input, the settings, the model file or device, and the code of
all that the packages which compute the answer install: a changed line of code asks again.
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
    """The answers of one prior.

    Args:
        prior: its name.
    """

    def __init__(self, prior: str) -> None:
        self._cache = Cache(prior)

    def load(self, key: str) -> dict[str, Tensor] | None:
        """The tensors saved under a key, or None."""
        from safetensors.torch import load_file

        return self._cache.load(key, lambda folder: load_file(folder / _ANSWER))

    def save(
        self,
        key: str,
        tensors: Mapping[str, Tensor],
        pictures: Mapping[str, Tensor],
        facts: Mapping[str, Any],
    ) -> None:
        """Keep an answer.

        Args:
            pictures: `[H, W, 3]` in [0, 1] by file name without ending.
        """
        from safetensors import SafetensorError
        from safetensors.torch import save_file

        def write(folder: Path) -> None:
            try:
                save_file(dict(tensors), folder / _ANSWER)
            except SafetensorError as error:  # what it makes of a full disk
                raise OSError(str(error)) from error
            write_json(folder / "answer.json", {"key": key, **facts})
            for name, picture in pictures.items():
                save_png(picture, folder / f"{name}.png")

        self._cache.save(key, write)


def code_digest(component: type) -> str:
    """A hash over the source of all that the component's package installs, of the host and of the engine."""
    modules = {*owned_modules(component.__module__), "registry", "core_rasterizer"}
    return content_key(
        component.__qualname__,
        component.__module__,
        *(source_digest(name) for name in sorted(modules)),
    )


def owned_modules(module: str) -> frozenset[str]:
    """The top-level modules of the plugin package that a module belongs to; of others, its own alone."""
    top = module.partition(".")[0]
    for package in {id(e.dist): e.dist for e in entry_points(group=GROUP)}.values():
        names = _top_level(package) if package else frozenset[str]()
        if top in names:
            return names
    return frozenset((top,))


def _top_level(package: Distribution) -> frozenset[str]:
    """What a package installs, by the list that setuptools writes, or by the list of its files."""
    listed = package.read_text("top_level.txt")
    if listed is not None:
        return frozenset(listed.split())
    files = [file for file in package.files or () if file.suffix == ".py"]
    return frozenset(file.parts[0].removesuffix(".py") for file in files)


@cache
def source_digest(name: str) -> str:
    """A hash over a top-level module, or over every file of source in a package."""
    spec = find_spec(name) if name != "__main__" else None
    folders = list(spec.submodule_search_locations or ()) if spec else []
    if spec and not folders and spec.origin:
        return hashlib.sha256(Path(spec.origin).read_bytes()).hexdigest()
    digest = hashlib.sha256(name.encode())
    for folder in map(Path, folders):
        for path in sorted(p for p in folder.rglob("*") if p.suffix in _SOURCES):
            digest.update(str(path.relative_to(folder)).encode() + b"\0" + path.read_bytes())
    return digest.hexdigest()
