"""Answers of prior models on disk, found again by the content of the question.

    STEREOGS_CACHE/<prior>/<key>/answer.safetensors   the tensors, bit for bit
                                 answer.json          what was asked, for people
                                 *.png                the answer as pictures

The key is a hash over every bit of the input, the settings, the model file or device, and the code of
the packages that compute the answer: a changed line of code asks again.
"""

from __future__ import annotations

import hashlib
import sys
from collections.abc import Mapping
from functools import cache
from pathlib import Path
from typing import TYPE_CHECKING, Any

from ..cache import Cache, content_key
from ..drawing.pictures import save_png
from ..files import write_json

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
    """A hash over the source of the component's package, of the host and of the engine."""
    packages = {component.__module__.partition(".")[0], "registry", "core_rasterizer"}
    return content_key(
        component.__qualname__, component.__module__, *(_package(p) for p in sorted(packages))
    )


@cache
def _package(name: str) -> str:
    file = getattr(sys.modules.get(name), "__file__", None)
    if file is None:
        return name
    root = Path(file)
    files = [root]
    if root.name == "__init__.py":
        files = sorted(p for p in root.parent.rglob("*") if p.suffix in _SOURCES)
    digest = hashlib.sha256()
    for path in files:
        digest.update(path.name.encode() + b"\0" + path.read_bytes())
    return digest.hexdigest()
