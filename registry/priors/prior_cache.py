"""Answers of prior models on disk, found again by the content of the question.

    STEREOGS_CACHE/<prior>/<key>/answer.safetensors   the tensors, bit for bit
                                 answer.json          what was asked, for people
                                 *.png                the answer as pictures

The key is a hash over every bit of the input, the settings, the model file or device, and the code of
the packages that compute the answer: a changed line of code asks again. Deleting anything is safe.
"""

from __future__ import annotations

import hashlib
import logging
import os
import shutil
import sys
from collections.abc import Mapping
from functools import cache
from pathlib import Path
from typing import Any

from safetensors import SafetensorError
from safetensors.torch import load_file, save_file
from torch import Tensor

from ..drawing.pictures import save_png
from ..files import new_folder, write_json

VARIABLE = "STEREOGS_CACHE"
"""Environment variable: the cache's folder; empty switches the cache off."""
_ANSWER = "answer.safetensors"
_SOURCES = (".py", ".cl")
_log = logging.getLogger(__name__)


class PriorCache:
    """The answers of one prior.

    Args:
        folder: where they lie, or None: nothing is kept.
    """

    def __init__(self, folder: Path | None) -> None:
        self.folder = folder

    @staticmethod
    def default(prior: str) -> PriorCache:
        """In the folder that STEREOGS_CACHE names, else in the user's cache folder."""
        return PriorCache(cache_folder(prior))

    def load(self, key: str) -> dict[str, Tensor] | None:
        """The tensors saved under a key, or None; a damaged file is reported and asked anew."""
        if self.folder is None:
            return None
        path = self.folder / key / _ANSWER
        if not path.is_file():
            return None
        try:
            tensors: dict[str, Tensor] = load_file(path)
        except (SafetensorError, OSError) as error:
            _log.warning("the cached answer %s is damaged (%s); asking again", path, error)
            shutil.rmtree(path.parent, ignore_errors=True)
            return None
        return tensors

    def save(
        self,
        key: str,
        tensors: Mapping[str, Tensor],
        pictures: Mapping[str, Tensor],
        facts: Mapping[str, Any],
    ) -> None:
        """Keep an answer. A full or read-only disk is reported; the run goes on without.

        Args:
            pictures: `[H, W, 3]` in [0, 1] by file name without ending.
        """
        if self.folder is None:
            return
        try:
            with new_folder(self.folder / key) as folder:
                save_file(dict(tensors), folder / _ANSWER)
                write_json(folder / "answer.json", {"key": key, **facts})
                for name, picture in pictures.items():
                    save_png(picture, folder / f"{name}.png")
        except OSError as error:
            if not (self.folder / key / _ANSWER).is_file():  # else another process was first
                _log.warning("the prior's answer could not be cached: %s", error)


def cache_folder(name: str) -> Path | None:
    """The folder of one kind of cached things; None where STEREOGS_CACHE switches caching off."""
    named = os.environ.get(VARIABLE)
    if named is None:
        home = os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache"
        return Path(home) / "stereogs" / name
    return Path(named) / name if named else None


def content_key(*parts: object) -> str:
    """A hash over tensors (type, shape and every bit), texts, numbers and None, in order."""
    digest = hashlib.sha256()
    for part in parts:
        if isinstance(part, Tensor):
            array = part.detach().cpu().contiguous().numpy()
            digest.update(f"{array.dtype}{array.shape}".encode())
            digest.update(array.tobytes())
        else:
            digest.update(repr(part).encode())
        digest.update(b"\0")
    return digest.hexdigest()[:32]


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
