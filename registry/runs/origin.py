"""Origin of a result: digests of all inputs, versions, commit, machine, device, seed and command line."""

from __future__ import annotations

import hashlib
import json
import os
import platform
import re
import subprocess
import sys
from collections.abc import Iterator, Mapping
from dataclasses import fields
from datetime import UTC, datetime
from importlib.metadata import PackageNotFoundError, distribution, requires, version
from pathlib import Path
from typing import Any
from urllib.parse import urlparse
from urllib.request import url2pathname
from uuid import uuid4

from torch import Tensor

from core_rasterizer import Device

from ..contract.scene import Scene, View
from ..errors import RunError
from ..pipeline.pipeline import Pipeline

_DIGEST_BYTES = 16
_HASH_SETTING = "sha256"
"""End of the names of settings that hold a file's hash."""
_SHOWN = 5
_OURS = "stereogs-plugins"
_NAME = re.compile(r"[A-Za-z0-9._-]+")
_ROOT = Path(__file__).parents[2]
_PACKAGES = ("core_rasterizer", "registry", "stereogs", "stereogs_plugins")
_GIT_SECONDS = 10.0


def input_digests(scene: Scene, pipeline: Pipeline) -> dict[str, str]:
    """Return digests of all inputs of a run, by a readable name.

    They cover every bit of the scene, and the hashes of model files in the pipeline. BLAKE2b, 16 bytes in
    hexadecimal.
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
    """Return the names of inputs that differ, are new or are missing."""
    return tuple(name for name in {**before, **now} if before.get(name) != now.get(name))


def refuse_changed(changed: tuple[str, ...], where: Path) -> None:
    """Raise a `RunError` if any input has changed.

    Args:
        changed: names from `changed_inputs`.
        where: the run folder.
    """
    if changed:
        raise RunError(
            f"the inputs of the run have changed: {listed(changed)}",
            where=str(where),
            fix="restore them, train again, or continue with --accept-changed-inputs",
        )


def listed(names: tuple[str, ...]) -> str:
    """Return the first names, and the number of the others."""
    more = len(names) - _SHOWN
    return ", ".join(names[:_SHOWN]) + (f" and {more} more" if more > 0 else "")


def _names(views: tuple[View, ...]) -> Iterator[str]:
    return (view.name for view in views)


def _view(view: View) -> Iterator[tuple[str, str]]:
    yield "photograph", _digest(view.image)
    camera = (getattr(view.camera, field.name) for field in fields(view.camera))
    yield "camera", _digest(*(v if isinstance(v, Tensor) else repr(v) for v in camera))
    for part in ("mask", "alpha", "depth"):
        values: Tensor | None = getattr(view, part)
        if values is not None:
            yield part, _digest(values)


def _digest(*parts: Tensor | str) -> str:
    """Digest texts, and tensors with their shapes and types; boundaries between parts count."""
    hasher = hashlib.blake2b(digest_size=_DIGEST_BYTES)
    for part in parts:
        if isinstance(part, Tensor):
            hasher.update(f"{part.dtype}{tuple(part.shape)};".encode())
            hasher.update(part.detach().contiguous().numpy().data)
        else:
            hasher.update(f"{len(part)}:{part};".encode())
    return hasher.hexdigest()


def provenance(pipeline: Pipeline, device: Device) -> dict[str, Any]:
    """Return the facts that are needed to repeat a run, as JSON values."""
    return {
        "run": uuid4().hex,
        "seed": pipeline.training.seed,
        **circumstances(pipeline, device),
        "resumed": [],
    }


def circumstances(pipeline: Pipeline, device: Device) -> dict[str, Any]:
    """Return the current software, machine and command line, as JSON values."""
    offers = {item.qualified_name: item.offer for item in pipeline}
    authors = dict.fromkeys(offer.distribution for offer in offers.values())
    return {
        "started": datetime.now(UTC).isoformat(timespec="seconds"),
        "command": sys.argv,
        "device": describe_device(device),
        "platform": platform.platform(),
        "processor": platform.machine(),
        "python": sys.version.split()[0],
        "source": checkout(),
        "packages": {name: _version(name) for name in _packages()},
        "plugins": {
            name: f"{offer.distribution} {offer.version}" for name, offer in offers.items()
        },
        "plugin_sources": {name: package_source(name) for name in authors if name != _OURS},
    }


def _packages() -> list[str]:
    """Return this package and its required dependencies."""
    needed = [text for text in requires(_OURS) or () if "extra ==" not in text]
    return [_OURS, *(found[0] for text in needed if (found := _NAME.match(text)))]


def describe_device(device: Device) -> dict[str, str]:
    """Return the OpenCL device as JSON values; `built_for` only if the device has one."""
    built_for = {"built_for": device.built_for} if device.built_for else {}
    return {
        "name": device.name,
        "platform": device.platform,
        "kind": device.kind,
        "driver": device.driver,
        **built_for,
    }


def _version(package: str) -> str:
    try:
        return version(package)
    except PackageNotFoundError:
        return "not installed"


def checkout(root: Path = _ROOT) -> dict[str, Any] | None:
    """Return the commit, and whether the packages differ from it; None outside a checkout or without git.

    Args:
        root: the folder that holds the packages.
    """
    if not (root / ".git").exists():  # a repository around site-packages belongs to somebody else
        return None
    return _state(root, *_PACKAGES)


def package_source(name: str) -> dict[str, Any] | None:
    """Return the commit that an installed package was built from, as the installer recorded it (PEP 610).

    For an editable package: the commit that is checked out, and whether files differ from it. None for
    packages from an index.
    """
    try:
        noted = json.loads(distribution(name).read_text("direct_url.json") or "{}")
    except (PackageNotFoundError, ValueError, OSError):
        return None
    if "vcs_info" in noted:
        return {"commit": noted["vcs_info"]["commit_id"], "dirty": False}
    place = urlparse(noted.get("url", ""))
    folder = Path(url2pathname(place.path))
    if place.scheme != "file" or not noted.get("dir_info", {}).get("editable"):
        return None
    return _state(folder, ".") if _git(folder, "ls-files", "--", ".") else None


def _state(folder: Path, *parts: str) -> dict[str, Any] | None:
    """Return the commit of the checkout around a folder, and whether parts of the folder differ from it."""
    commit = _git(folder, "rev-parse", "HEAD")
    changes = _git(folder, "status", "--porcelain", "--", *parts)
    if commit is None or changes is None:
        return None
    return {"commit": commit, "dirty": bool(changes)}


def _git(root: Path, *arguments: str) -> str | None:
    try:
        done = subprocess.run(
            ["git", "-C", str(root), *arguments],
            env={**os.environ, "GIT_OPTIONAL_LOCKS": "0"},
            capture_output=True,
            text=True,
            timeout=_GIT_SECONDS,
            check=True,
        )
    except (OSError, subprocess.SubprocessError):
        return None
    return done.stdout.strip()
