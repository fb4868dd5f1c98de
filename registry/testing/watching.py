"""What a component must leave as it found it: what it was given, and what all share.

with untouched({"scene": scene}), own_randomness(), same_process():
    component.loss(step)
"""

from __future__ import annotations

import hashlib
import os
import pickle
import random
from collections.abc import Iterator, Mapping
from contextlib import contextmanager, suppress
from dataclasses import fields, is_dataclass
from pathlib import Path
from typing import Any

import numpy as np
import torch
from torch import Tensor

from core_rasterizer import GaussianModel, GaussianReader

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
def own_randomness() -> Iterator[None]:
    """Fail if a global random generator was drawn from or seeded; all three are as before afterwards.

    Raises:
        AssertionError: naming the generator.
    """
    kept = torch.get_rng_state(), random.getstate(), np.random.get_state()
    torch.manual_seed(_SEED)
    random.seed(_SEED)
    np.random.seed(_SEED)
    before = _global_generators()
    try:
        yield
        used = [name for name, state in _global_generators().items() if state != before[name]]
    finally:
        torch.set_rng_state(kept[0])
        random.setstate(kept[1])
        np.random.set_state(kept[2])
    require(
        not used,
        f"it drew from or seeded the global random state of {' and '.join(used)}; "
        "draw from self.generator, which is the component's own",
    )


@contextmanager
def same_process() -> Iterator[None]:
    """Fail if a switch of the whole process was left in another position; puts them back.

    Raises:
        AssertionError: naming the switch.
    """
    gradients, kind, folder = torch.is_grad_enabled(), torch.get_default_dtype(), Path.cwd()
    try:
        yield
        left = {
            "gradients switched off": torch.is_grad_enabled() != gradients,
            "another default dtype of torch": torch.get_default_dtype() != kind,
            "another working directory": Path.cwd() != folder,
        }
    finally:
        torch.set_grad_enabled(gradients)
        torch.set_default_dtype(kind)
        os.chdir(folder)
    faults = [name for name, changed in left.items() if changed]
    require(not faults, f"it left {' and '.join(faults)} behind")


def _global_generators() -> dict[str, bytes]:
    return {
        "torch": torch.get_rng_state().numpy().tobytes(),
        "Python": pickle.dumps(random.getstate()),
        "numpy": pickle.dumps(np.random.get_state()),
    }


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
