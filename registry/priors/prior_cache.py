"""Cache of estimates on disk, and the digest of the code that computes them.

    STEREOGS_CACHE/<prior>/<key>/answer.safetensors   the tensors, bit for bit
                                 answer.json          the inputs, human-readable
                                 *.png                images of the estimate

The key is a hash of all bits of the input, the settings, the prior's fingerprint, and all code of the
packages that compute the estimate: any changed line of code invalidates the entry.
"""

from __future__ import annotations

import hashlib
from collections.abc import Callable, Mapping, Sequence
from functools import cache
from importlib.metadata import Distribution, entry_points
from importlib.util import find_spec
from pathlib import Path
from typing import TYPE_CHECKING, Any

from ..contract.prior import Prior
from ..contract.scene import TrainingView
from ..plugins.discovery import GROUP
from ..system.files import write_json
from ..toolkit.cache import Cache, content_key
from ..toolkit.drawing.pictures import save_png

if TYPE_CHECKING:
    from torch import Tensor

_ANSWER = "answer.safetensors"
_SOURCES = (".py", ".cl")


def cached(
    prior: Prior[Any],
    views: Sequence[TrainingView],
    arguments: Sequence[Any],
    compute: Callable[[], dict[str, Tensor]],
    pictures: Callable[[dict[str, Tensor]], dict[str, Tensor]],
) -> dict[str, Tensor]:
    """Return an estimate for views, from the disk cache if possible.

    Args:
        arguments: Inputs of the estimate besides the views, the settings, the code and
            `Prior.fingerprint`.
        compute: Function that computes the estimate; called without gradients.
        pictures: Function that returns images of the estimate, by file name without suffix.
    """
    with prior.context.at_work():
        fingerprint = prior.fingerprint()
    key = content_key(
        code_digest(type(prior)),
        prior.settings.model_dump_json(),
        fingerprint,
        *arguments,
        *(part for view in views for part in (view.image, view.mask, view.alpha)),
        *(part for view in views for part in (view.camera.world_to_camera, view.camera.intrinsics)),
    )
    name = prior.context.name
    found = load_estimate(name, key)
    if found is None:
        import torch

        with torch.no_grad():
            found = {label: tensor.contiguous() for label, tensor in compute().items()}
        facts = {"views": list(map(stem, views)), "question": list(map(str, arguments))}
        save_estimate(name, key, found, pictures(found), facts)
    return found


def stem(view: TrainingView) -> str:
    """Return a view's name without suffix, for file names of images."""
    return view.name.partition(".")[0]


def load_estimate(prior: str, key: str) -> dict[str, Tensor] | None:
    """Return the tensors that the prior of that name saved under a key, or None."""
    from safetensors.torch import load_file

    return Cache(prior).load(key, lambda folder: load_file(folder / _ANSWER))


def save_estimate(
    prior: str,
    key: str,
    tensors: Mapping[str, Tensor],
    pictures: Mapping[str, Tensor],
    facts: Mapping[str, Any],
) -> None:
    """Save an estimate, with pictures `[H, W, 3]` in [0, 1] by file name, and facts for answer.json."""
    from safetensors import SafetensorError
    from safetensors.torch import save_file

    def write(folder: Path) -> None:
        try:
            save_file(dict(tensors), folder / _ANSWER)
        except SafetensorError as error:  # for example on a full disk
            raise OSError(str(error)) from error
        write_json(folder / "answer.json", {"key": key, **facts})
        for name, picture in pictures.items():
            save_png(picture, folder / f"{name}.png")

    Cache(prior).save(key, write)


def code_digest(component: type) -> str:
    """Return a hash of the source of the component's package, the host and the engine."""
    modules = {*_package_modules(component.__module__), "registry", "core_rasterizer"}
    digests = map(source_digest, sorted(modules))
    return content_key(component.__qualname__, component.__module__, *digests)


def _package_modules(module: str) -> frozenset[str]:
    """Return the top-level modules of the plugin package of a module; its own for other packages."""
    top = module.partition(".")[0]
    for package in {id(e.dist): e.dist for e in entry_points(group=GROUP)}.values():
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
def source_digest(name: str) -> str:
    """Return a hash of a top-level module, or of all source files of a package."""
    spec = find_spec(name) if name != "__main__" else None
    folders = list(spec.submodule_search_locations or ()) if spec else []
    if spec and not folders and spec.origin:
        return hashlib.sha256(Path(spec.origin).read_bytes()).hexdigest()
    digest = hashlib.sha256(name.encode())
    for folder in map(Path, folders):
        for path in sorted(p for p in folder.rglob("*") if p.suffix in _SOURCES):
            digest.update(str(path.relative_to(folder)).encode() + b"\0" + path.read_bytes())
    return digest.hexdigest()
