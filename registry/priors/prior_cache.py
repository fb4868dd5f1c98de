"""Cache of estimates on disk.

    STEREOGS_CACHE/<prior>/<key>/answer.safetensors   the tensors, bit for bit
                                 answer.json          the inputs, human-readable
                                 *.png                images of the estimate

The key is a hash of all bits of the input, the settings, the prior's fingerprint, and all code of the
packages that compute the estimate: any changed line of code invalidates the entry.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

from registry.toolkit.cache.keys import package_digest

from ..contract.prior import Prior
from ..contract.scene import TrainingView
from ..discovery import GROUP
from ..system.files import write_json
from ..toolkit.cache import Cache, content_key
from ..toolkit.drawing.pictures import save_png

if TYPE_CHECKING:
    from torch import Tensor

_ANSWER = "answer.safetensors"


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
    name = prior.context.name
    if Cache(name).folder is None:
        return _computed(compute)
    origin = identity(prior)
    key = content_key(
        origin,
        *arguments,
        *(part for view in views for part in (view.image, view.mask, view.alpha)),
        *(view.weights for view in views if view.weights is not None),
        *(part for view in views for part in (view.camera.world_to_camera, view.camera.intrinsics)),
    )
    found = load_estimate(name, key)
    if found is None:
        from torch import Tensor

        found = _computed(compute)
        words = [str(argument) for argument in arguments if not isinstance(argument, Tensor)]
        facts = {"views": list(map(stem, views)), "question": words}
        if identity(prior) == origin:  # else `compute` opened a model, which the key lacks
            save_estimate(name, key, found, pictures(found), facts)
    return found


def _computed(compute: Callable[[], dict[str, Tensor]]) -> dict[str, Tensor]:
    import torch

    with torch.no_grad():
        return {label: tensor.contiguous() for label, tensor in compute().items()}


def identity(prior: Prior[Any]) -> str:
    """Return a hash of a prior's code, settings and fingerprint; equal ones answer alike."""
    with prior.context.at_work():
        fingerprint = prior.fingerprint()
    code = package_digest(type(prior), GROUP)
    return content_key(code, prior.settings.model_dump_json(), fingerprint)


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
