"""What a run was made from, by digests: so that it does not go on with something else unnoticed."""

from __future__ import annotations

import hashlib
from collections.abc import Iterator, Mapping
from dataclasses import fields
from pathlib import Path
from typing import Any

from torch import Tensor

from core_rasterizer import Camera

from ...contract.checks.scene import validate
from ...contract.scene import Scene, View
from ...errors import RunError
from ...pipeline.parts import Parts
from ...pipeline.pipeline import Pipeline

_DIGEST_BYTES = 16
_HASH_SETTING = "sha256"
"""How settings end that name a file by its content."""
_SHOWN = 5


def load_scene(parts: Parts) -> Scene:
    """Let the scene loader load, and validate what it returns."""
    loader = parts.one("scene")
    with loader.at_work():
        return validate(loader.component.load())


def input_digests(scene: Scene, pipeline: Pipeline) -> dict[str, str]:
    """Digests of all that a run reads, by what it is, for people.

    Of the scene every bit that the loader returned: photographs, cameras, masks, alphas, depths, points,
    bounds. Of model files the hashes that the pipeline names them by. BLAKE2b, 16 bytes in hexadecimal.
    """
    digests = {
        "the order of the views": _digest(*_names(scene.train), "", *_names(scene.test)),
        "the depth bounds": _digest(repr(scene.bounds)),
        "the background": _digest(repr(scene.background)),
    }
    if scene.points is not None:
        arrays = (scene.points.positions, scene.points.colors)
        optional = (scene.points.scales, scene.points.opacities)
        digests["the points"] = _digest(*arrays, *(a for a in optional if a is not None))
    for view in (*scene.train, *scene.test):
        digests |= {f"the {part} of {view.name}": digest for part, digest in _view(view)}
    for item in pipeline:
        for name, value in item.settings.model_dump(mode="json").items():
            if name.endswith(_HASH_SETTING) and value is not None:
                digests[f"the file of {item.qualified_name}.{name}"] = str(value)
    return digests


def changed_inputs(before: Mapping[str, str], now: Mapping[str, str]) -> tuple[str, ...]:
    """What is another, new or missing, as `input_digests` calls it."""
    return tuple(name for name in {**before, **now} if before.get(name) != now.get(name))


def refuse_changed(changed: tuple[str, ...], where: Path) -> None:
    """Refuse to go on with other inputs.

    Args:
        changed: what `changed_inputs` found.
        where: the run's folder.

    Raises:
        RunError: something has changed.
    """
    if changed:
        raise RunError(
            f"the run was made from other inputs; changed: {listed(changed)}",
            where=str(where),
            fix="bring back what it was made from, train anew, or go on with --accept-changed-inputs",
        )


def listed(names: tuple[str, ...]) -> str:
    """The first names, and how many more there are."""
    more = len(names) - _SHOWN
    return ", ".join(names[:_SHOWN]) + (f" and {more} more" if more > 0 else "")


def _names(views: tuple[View, ...]) -> Iterator[str]:
    return (view.name for view in views)


def _view(view: View) -> Iterator[tuple[str, str]]:
    yield "photograph", _digest(view.image)
    yield "camera", _digest(*_numbers(view.camera))
    for part in ("mask", "alpha", "depth"):
        values: Tensor | None = getattr(view, part)
        if values is not None:
            yield part, _digest(values)


def _numbers(camera: Camera) -> Iterator[Any]:
    for field in fields(camera):
        value = getattr(camera, field.name)
        yield value if isinstance(value, Tensor) else repr(value)


def _digest(*parts: Tensor | str) -> str:
    """Of texts, and of tensors with their shapes and types; none runs into the next."""
    hasher = hashlib.blake2b(digest_size=_DIGEST_BYTES)
    for part in parts:
        if isinstance(part, Tensor):
            hasher.update(f"{part.dtype}{tuple(part.shape)};".encode())
            hasher.update(part.detach().contiguous().numpy().data)
        else:
            hasher.update(f"{len(part)}:{part};".encode())
    return hasher.hexdigest()
