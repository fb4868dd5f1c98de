"""Assertions about results, and about side effects of a component."""

from __future__ import annotations

import hashlib
from collections.abc import Iterator, Mapping
from contextlib import contextmanager, suppress
from dataclasses import fields, is_dataclass
from pathlib import Path
from typing import Any

from torch import Tensor

from core_rasterizer import GaussianModel, GaussianReader

from ..calls.process_state import left_as_found, no_global_random_numbers, own_random_numbers
from ..calls.watchdog import WATCHDOG
from ..contract.prior import Prior
from ..contract.step import Step
from ..errors import PluginError

_SEED = 0x5EED
"""No component is likely to seed a generator with this number; if one did, it would not be noticed."""


def require(holds: bool, message: str) -> None:
    """Raise an AssertionError with the message unless the condition holds.

    Unlike `assert`, it works under `python -O`.
    """
    if not holds:
        raise AssertionError(message)


def require_files(files: Any) -> None:
    """Raise an AssertionError unless `files` is a list of existing files."""
    require(isinstance(files, list), "the answer is not a list of the files written")
    for file in files:
        require(Path(file).is_file(), f"the file {file} was not written")


@contextmanager
def no_side_effects(given: Mapping[str, Any]) -> Iterator[None]:
    """Check that a block changes neither its arguments nor state that the process shares.

    It may add files to a folder. It must not draw from global random generators.

    Args:
        given: the arguments by name.

    Raises:
        AssertionError: an argument was changed; names the part, for example "scene.train[0].image".
        PluginError: shared state was changed; it is restored.
    """
    before = dict(_digests("", given))
    with (
        WATCHDOG.watching("the component"),  # starts the host's thread before threads are counted
        own_random_numbers(_SEED),
        left_as_found("the component"),
        no_global_random_numbers(),
    ):
        yield
    after = dict(_digests("", given))
    changed = [name for name, digest in before.items() if after.get(name) != digest]
    require(not changed, f"it changed what it was given: {', '.join(changed[:3])}")


def first_difference(first: Any, second: Any) -> str | None:
    """Return the path of the first part in which two values differ by a bit; None if they are equal.

    Compares tensors, numbers, text, and dataclasses, mappings and sequences of them.
    """
    one, other = digests(first), digests(second)
    return next((name for name in one | other if one.get(name) != other.get(name)), None)


def digests(value: Any) -> dict[str, str]:
    """Return a digest of every part of a value, by its path."""
    return dict(_digests("", value))


def _digests(name: str, value: Any) -> Iterator[tuple[str, str]]:
    """Yield the path and a digest of every mutable part of a value; of a folder, every file."""
    if isinstance(value, Tensor):
        content = value.detach().cpu().contiguous().numpy().tobytes()
        yield name, f"{value.dtype}{tuple(value.shape)}{_digest(content)}"
    elif isinstance(value, GaussianReader | GaussianModel):
        yield name, value.digest()
    elif isinstance(value, Path):
        for file in sorted(value.rglob("*")) if value.is_dir() else [value]:
            if file.is_file():
                path = file.relative_to(value.parent)
                yield f"{name}: the file {path}", _digest(file.read_bytes())
    elif isinstance(value, Prior):
        return
    elif isinstance(value, Mapping):
        for key, inner in value.items():
            yield from _digests(f"{name}.{key}".lstrip("."), inner)
        yield f"{name} (its names)", repr(sorted(map(str, value)))
    elif isinstance(value, list | tuple):
        for index, inner in enumerate(value):
            yield from _digests(f"{name}[{index}]", inner)
        yield f"{name} (its length)", repr(len(value))
    elif is_dataclass(value) and not isinstance(value, type):
        for field in fields(value):
            if not field.name.startswith("_"):
                yield from _digests(f"{name}.{field.name}", getattr(value, field.name))
        if isinstance(value, Step):
            yield from _digests(f"{name}.others", value.others)
            with suppress(PluginError):  # not rendered yet
                yield from _digests(f"{name}.rendering", value.rendering)
    elif isinstance(value, bytes):
        yield name, _digest(value)
    elif isinstance(value, str | int | float | None):
        yield name, repr(value)


def _digest(content: bytes) -> str:
    return hashlib.blake2b(content, digest_size=16).hexdigest()
