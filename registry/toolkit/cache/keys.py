"""Keys of cache entries: hashes of inputs and of code."""

from __future__ import annotations

import hashlib
import inspect
from functools import cache
from importlib.metadata import Distribution, entry_points
from importlib.util import find_spec
from pathlib import Path
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from collections.abc import Callable
    from types import ModuleType

_SOURCES = (".py", ".cl")


def content_key(*parts: object) -> str:
    """Return a hash of tensors (type, shape, bits), bytes, texts, numbers and None: 32 hexadecimal digits."""
    from torch import Tensor

    digest = hashlib.sha256()
    for part in parts:
        if isinstance(part, Tensor):
            array = part.detach().cpu().contiguous().numpy()
            digest.update(f"{array.dtype}{array.shape}".encode())
            digest.update(array.tobytes())
        elif isinstance(part, bytes):
            digest.update(f"{len(part)} bytes\0".encode())
            digest.update(part)
        else:
            digest.update(repr(part).encode())
        digest.update(b"\0")
    return digest.hexdigest()[:32]


def source_digest(*definitions: Callable[..., Any] | ModuleType) -> str:
    """Return a hash of the source files that define classes, functions or modules.

    As part of a key, it invalidates entries when the code that computes them changes.

    Raises:
        TypeError: An argument is not defined in a file.
    """
    files = [inspect.getfile(definition) for definition in definitions]
    return content_key(*(Path(file).read_bytes() for file in files))


def package_digest(component: type, group: str) -> str:
    """Return a hash of a class's name, all code of its package, and the code of the host and the engine.

    Args:
        group: the entry-point group in which its package may be listed.
    """
    host = map(module_digest, ("core_rasterizer", "registry"))
    own = code_digest(component, group)
    return content_key(component.__qualname__, component.__module__, own, *host)


def code_digest(component: type, group: str) -> str:
    """Return a hash of all code of a class's package, as in `package_digest`."""
    modules = _package_modules(component.__module__, group)
    return content_key(*map(module_digest, sorted(modules)))


def _package_modules(module: str, group: str) -> frozenset[str]:
    """Return the top-level modules of the plugin package of a module; its own for other packages."""
    top = module.partition(".")[0]
    for package in {id(e.dist): e.dist for e in entry_points(group=group)}.values():
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
def module_digest(name: str) -> str:
    """Return a hash of a top-level module, or of all source files of a package."""
    spec = find_spec(name) if name != "__main__" else None
    folders = list(spec.submodule_search_locations or ()) if spec else []
    if spec and not folders and spec.origin:
        return hashlib.sha256(Path(spec.origin).read_bytes()).hexdigest()
    digest = hashlib.sha256(name.encode())
    for folder in map(Path, folders):
        for path in sorted(p for p in folder.rglob("*") if p.suffix in _SOURCES):
            digest.update(path.relative_to(folder).as_posix().encode() + b"\0" + path.read_bytes())
    return digest.hexdigest()
