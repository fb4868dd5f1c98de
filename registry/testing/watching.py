"""What a component must leave as it found it: what it was given, and what all share.

with untouched({"scene": scene}), by_itself():
    component.loss(step)
"""

from __future__ import annotations

import hashlib
from collections.abc import Iterator, Mapping
from contextlib import contextmanager, suppress
from dataclasses import fields, is_dataclass
from pathlib import Path
from typing import Any

from torch import Tensor

from core_rasterizer import GaussianModel, GaussianReader

from ..calls.process_state import (
    left_as_found,
    no_global_random_numbers,
    own_random_numbers,
)
from ..calls.watchdog import WATCHDOG
from ..contract.prior import Prior
from ..contract.step import Step
from ..errors import PluginError
from .judging import require

_SEED = 0x5EED
"""A seed that nobody else is likely to choose: seeding with it would not be seen."""


@contextmanager
def untouched(given: Mapping[str, Any]) -> Iterator[None]:
    """Fail if something within the values is another afterwards; files may be added to a folder.

    Args:
        given: values by name; tensors, files and Gaussians are looked for in them, in dataclasses,
            mappings and sequences too.

    Raises:
        AssertionError: naming what was changed, for example "scene.train[0].image".
    """
    before = dict(_parts("", given))
    yield
    after = dict(_parts("", given))
    changed = [name for name, digest in before.items() if after.get(name) != digest]
    require(not changed, f"it changed what it was given: {', '.join(changed[:3])}")


@contextmanager
def by_itself() -> Iterator[None]:
    """Fail if the block draws from global random generators, or changes what the process shares.

    Raises:
        AssertionError: naming the first; everything is as before.
    """
    raised: BaseException | None = None
    try:
        with (
            WATCHDOG.watching(
                "the component"
            ),  # starts the host's own thread before threads are counted
            own_random_numbers(_SEED),
            left_as_found("the component"),
            no_global_random_numbers(),
        ):
            try:
                yield
            except BaseException as error:
                raised = error
                raise
    except PluginError as error:
        if error is raised:  # the block's own
            raise
        raise AssertionError(f"{error.what}; {error.fix}") from error


def _parts(name: str, value: Any) -> Iterator[tuple[str, str]]:
    """Everything in a value that could be changed, by its path, as a digest."""
    if isinstance(value, Tensor):
        yield name, f"{value.dtype}{tuple(value.shape)}{_digest(_bytes(value))}"
    elif isinstance(value, GaussianReader | GaussianModel):
        yield name, value.digest()
    elif isinstance(value, Path):
        yield from _files(name, value)
    elif isinstance(value, Prior):
        return
    elif isinstance(value, Mapping):
        yield f"{name} (its names)", repr(list(value))
        for key, inner in value.items():
            yield from _parts(f"{name}.{key}".lstrip("."), inner)
    elif isinstance(value, list | tuple):
        for index, inner in enumerate(value):
            yield from _parts(f"{name}[{index}]", inner)
    elif is_dataclass(value) and not isinstance(value, type):
        yield from _fields(name, value)
    elif isinstance(value, str | int | float | None):
        yield name, repr(value)


def _fields(name: str, value: Any) -> Iterator[tuple[str, str]]:
    for field in fields(value):
        if not field.name.startswith("_"):
            yield from _parts(f"{name}.{field.name}", getattr(value, field.name))
    if isinstance(value, Step):
        yield from _parts(f"{name}.others", value.others)
        with suppress(PluginError):  # before the render there is none to be changed
            yield from _parts(f"{name}.rendering", value.rendering)


def _files(name: str, path: Path) -> Iterator[tuple[str, str]]:
    files = sorted(path.rglob("*")) if path.is_dir() else [path]
    for file in files:
        if file.is_file():
            yield f"{name}: the file {file.relative_to(path.parent)}", _digest(file.read_bytes())


def _bytes(tensor: Tensor) -> bytes:
    return tensor.detach().cpu().contiguous().numpy().tobytes()


def _digest(content: bytes) -> str:
    return hashlib.blake2b(content, digest_size=16).hexdigest()
