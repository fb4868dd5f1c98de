"""Cache estimates for the views of a scene."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from typing import TYPE_CHECKING, Any, TypeAlias

from ..toolkit.cache import content_key
from .prior_cache import PriorCache, code_digest

if TYPE_CHECKING:
    from torch import Tensor

    from ..contract.prior import Prior
    from ..contract.scene import TrainingView

Tensors: TypeAlias = "dict[str, Tensor]"
Pictures: TypeAlias = "Mapping[str, Tensor]"


def cached(
    prior: Prior[Any],
    views: Sequence[TrainingView],
    arguments: Sequence[Any],
    compute: Callable[[], Tensors],
    pictures: Callable[[Tensors], Pictures],
) -> Tensors:
    """Return an estimate for views, from the disk cache if possible.

    Args:
        arguments: Inputs of the estimate besides the views, the settings, the code and
            `Prior.fingerprint`.
        compute: Function that computes the estimate; called without gradients.
        pictures: Function that returns images of the estimate, by file name without suffix.
    """
    import torch

    cache = PriorCache(prior.context.name)
    with prior.context.at_work():
        fingerprint = prior.fingerprint()
    key = content_key(
        code_digest(type(prior)),
        prior.settings.model_dump_json(),
        fingerprint,
        *arguments,
        *(part for view in views for part in _content(view)),
    )
    found = cache.load(key)
    if found is None:
        with torch.no_grad():
            found = {name: tensor.contiguous() for name, tensor in compute().items()}
        facts = {
            "views": [stem(view) for view in views],
            "question": [str(argument) for argument in arguments],
        }
        cache.save(key, found, pictures(found), facts)
    return found


def stem(view: TrainingView) -> str:
    """Return a view's name without suffix, for file names of images."""
    return view.name.partition(".")[0]


def _content(view: TrainingView) -> tuple[Tensor | None, ...]:
    """Return all data of a view that an estimate may depend on."""
    camera = view.camera
    return view.image, view.mask, view.alpha, camera.world_to_camera, camera.intrinsics
