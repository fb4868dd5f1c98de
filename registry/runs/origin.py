"""Origin of a result: digests of its inputs, and the software, machine and command line."""

from __future__ import annotations

import hashlib
import json
import logging
import os
import platform
import re
import subprocess
import sys
from collections.abc import Iterable, Mapping
from dataclasses import fields
from datetime import UTC, datetime
from importlib.metadata import PackageNotFoundError, distribution, requires, version
from pathlib import Path
from typing import Any
from urllib.parse import urlparse
from urllib.request import url2pathname

from torch import Tensor

from core_rasterizer import Device, Engine, ExplainedError
from registry.toolkit.cache.keys import code_digest

from ..contract.scene import Scene
from ..discovery import GROUP, OWN_PACKAGE, Offer
from ..errors import RunError
from ..messages.visible_text import without_credentials
from ..pipeline.pipeline import Item, Pipeline
from ..pipeline.settings_check import leaves, recorded

_HASH_SETTING = "sha256"
"""End of the names of settings that hold a file's hash."""
_CONTENT = "the content of "
_SHOWN = 5
_ENGINE = "stereogs-rasterizer"
"""The distribution of `core_rasterizer`, on which ours depends."""
_MISSING = "not installed"
_CODE = ", code "
_NAME = re.compile(r"[A-Za-z0-9._-]+")
_ROOT = Path(__file__).parents[2]
_PACKAGES = ("core_rasterizer", "registry", "stereogs", "stereogs_plugins")
_GIT_SECONDS = 10.0
_log = logging.getLogger("stereogs")


def input_digests(scene: Scene, pipeline: Pipeline) -> dict[str, str]:
    """Return digests of all inputs of a run by a readable name: BLAKE2b, 16 bytes in hexadecimal.

    They cover every bit of the scene, and the model files of the pipeline.
    """
    train, test = ([view.name for view in views] for views in (scene.train, scene.test))
    digests = {
        "the order of the views": _digest(*train, "", *test),
        "the depth bounds": _digest(scene.bounds),
        "the background": _digest(scene.background),
    }
    if scene.points is not None:
        names = ("positions", "colors", "scales", "opacities")
        arrays = (getattr(scene.points, name) for name in names)
        # Single precision, in which older runs recorded them.
        digests["the points"] = _digest(*(array.float() for array in arrays if array is not None))
    for view in (*scene.train, *scene.test):
        camera = [getattr(view.camera, field.name) for field in fields(view.camera)]
        digests[f"the photograph of {view.name}"] = _digest(view.image)
        digests[f"the camera of {view.name}"] = _digest(*camera)
        for part in ("mask", "alpha", "weights", "depth"):
            if getattr(view, part) is not None:
                digests[f"the {part} of {view.name}"] = _digest(getattr(view, part))
    for item in pipeline:
        for name, value in recorded(item.settings).items():
            if name.endswith(_HASH_SETTING) and value is not None:
                digests[f"the file of {item.qualified_name}.{name}"] = str(value)
    for item in pipeline.items["priors"]:
        for name, value in item.settings:
            for number, path in enumerate(leaves(value, Path)):
                if (file := path.expanduser()).is_file():
                    place = f".{number}" if number else ""
                    digests[f"{_CONTENT}{item.qualified_name}.{name}{place}"] = _digest_of(file)
    return digests


def _digest_of(file: Path) -> str:
    with file.open("rb") as opened:
        return hashlib.file_digest(opened, lambda: hashlib.blake2b(digest_size=16)).hexdigest()


def _digest(*parts: Any) -> str:
    """Digest tensors with their shapes and types, and texts; boundaries between parts count."""
    hasher = hashlib.blake2b(digest_size=16)
    for part in parts:
        if isinstance(part, Tensor):
            hasher.update(f"{part.dtype}{tuple(part.shape)};".encode())
            hasher.update(part.detach().contiguous().numpy().data)
        else:
            text = part if isinstance(part, str) else repr(part)
            hasher.update(f"{len(text)}:{text};".encode())
    return hasher.hexdigest()


def changed_inputs(before: Mapping[str, str], now: Mapping[str, str]) -> tuple[str, ...]:
    """Return the names of inputs that differ, are new or are missing.

    A network's file may be missing, because its answers are cached or no longer needed.
    """
    changed = (name for name in {**before, **now} if before.get(name) != now.get(name))
    return tuple(x for x in changed if not x.startswith(_CONTENT) or (x in before and x in now))


def refuse_changed_inputs(
    before: Mapping[str, str], scene: Scene, pipeline: Pipeline, where: Path
) -> None:
    """Raise a RunError if an input has changed since `input_digests` returned `before`."""
    if changed := changed_inputs(before, input_digests(scene, pipeline)):
        raise RunError(
            f"the inputs of the run have changed: {listed(changed)}",
            where=str(where),
            fix="restore them, train again, or continue with --accept-changed-inputs",
        )


def listed(names: tuple[str, ...]) -> str:
    """Return the first names, and the number of the others."""
    more = len(names) - _SHOWN
    return ", ".join(names[:_SHOWN]) + (f" and {more} more" if more > 0 else "")


def circumstances(pipeline: Pipeline, engine: Engine) -> dict[str, Any]:
    """Return the current software, machine and command line, as JSON values."""
    offers = {item.qualified_name: item.offer for item in pipeline}
    authors = dict.fromkeys(offer.distribution for offer in offers.values())
    packages = [OWN_PACKAGE, *(name for ours in (OWN_PACKAGE, _ENGINE) for name in _required(ours))]
    return {
        "started": datetime.now(UTC).isoformat(timespec="seconds"),
        "command": [without_credentials(word) for word in sys.argv],
        "engine": engine.name,
        "device": describe_device(engine.device),
        "platform": platform.platform(),
        "processor": platform.machine(),
        "python": sys.version.split()[0],
        "hash_seed": os.environ.get("PYTHONHASHSEED"),
        "source": checkout(),
        "packages": {name: _version(name) for name in packages},
        "plugins": {name: package_of(offer) for name, offer in offers.items()},
        "plugin_sources": {name: package_source(name) for name in authors if name != OWN_PACKAGE},
    }


def package_of(offer: Offer) -> str:
    """Return the package of a component: name and version, and for others than ours a hash of its code."""
    return foreign_package(offer) or f"{offer.distribution} {offer.version}"


def foreign_package(offer: Offer) -> str:
    """`package_of` for components of other packages than ours; "" for ours."""
    if offer.distribution == OWN_PACKAGE:
        return ""
    code = code_digest(offer.component, GROUP)[:16]
    return f"{offer.distribution} {offer.version}{_CODE}{code}"


def refuse_changed_plugins(
    before: Mapping[str, str], items: Iterable[Item], where: Path, *, accept: bool
) -> None:
    """Refuse components whose package, or its code, is not the one that was recorded.

    Args:
        before: results of `package_of` by qualified name; unknown components are accepted.
        accept: log a warning instead.

    Raises:
        RunError: names the components, their packages and the recorded ones.
    """
    changed = []
    for item in items:
        now = package_of(item.offer)
        was = before.get(item.qualified_name, now)
        if was not in (now, now.partition(_CODE)[0]):  # older versions recorded no code
            changed.append(f"{item.qualified_name} is now of {now}, and was of {was}")
    if changed and accept:
        _log.warning("%s", listed(tuple(changed)))
    elif changed:
        raise RunError(
            f"plugins have changed since the run: {listed(tuple(changed))}",
            where=str(where),
            fix="install the version that was used, or continue with --accept-changed-plugins",
        )


def with_packages(error: ExplainedError, packages: Mapping[str, str]) -> ExplainedError:
    """Add the packages that wrote a run, results of `package_of`, to the fix of an error."""
    used = dict.fromkeys(text.partition(_CODE)[0] for text in packages.values())
    written = listed(
        tuple(name for name in used if name.partition(" ")[0] != OWN_PACKAGE) or tuple(used)
    )
    if written:
        error.fix = f"{error.fix}; the run was written with {written}"
    return error


def describe_device(device: Device) -> dict[str, str]:
    """Return the OpenCL device as JSON values."""
    return {name: getattr(device, name) for name in ("name", "platform", "kind", "driver")}


def _required(package: str) -> list[str]:
    """Return the names of what a package requires here, without extras and what is for other systems only."""
    texts = [text for text in requires(package) or () if "extra ==" not in text]
    names = [(found[0], ";" in text) for text in texts if (found := _NAME.match(text))]
    return [name for name, marked in names if not marked or _version(name) != _MISSING]


def _version(package: str) -> str:
    try:
        return version(package)
    except PackageNotFoundError:
        return _MISSING


def checkout(root: Path = _ROOT) -> dict[str, Any] | None:
    """Return the commit, and whether packages in `root` differ; None outside a checkout or without git."""
    # A repository that only encloses site-packages belongs to somebody else.
    return _commit(root, *_PACKAGES) if (root / ".git").exists() else None


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
    url = urlparse(noted.get("url", ""))
    folder = Path(url2pathname(url.path))
    if url.scheme != "file" or not noted.get("dir_info", {}).get("editable"):
        return None
    return _commit(folder, ".") if _git(folder, "ls-files", "--", ".") else None


def _commit(folder: Path, *parts: str) -> dict[str, Any] | None:
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
