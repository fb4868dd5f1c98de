"""Answers about a scene's views, kept on disk."""

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


def remembered(
    prior: Prior[Any],
    views: Sequence[TrainingView],
    question: Sequence[Any],
    ask: Callable[[], Tensors],
    pictures: Callable[[Tensors], Pictures],
) -> Tensors:
    """The answer to a question about views, from the disk cache if it was asked before.

    Args:
        question: what the answer depends on beside the views, the settings, the code and
            `Prior.fingerprint`.
        ask: gives the answer; called without gradients.
        pictures: what to keep beside it for people to look at, by file name without ending.
    """
    import torch

    cache = PriorCache(prior.context.name)
    with prior.context.at_work():
        fingerprint = prior.fingerprint()
    key = content_key(
        code_digest(type(prior)),
        prior.settings.model_dump_json(),
        fingerprint,
        *question,
        *(part for view in views for part in _content(view)),
    )
    found = cache.load(key)
    if found is None:
        with torch.no_grad():
            found = {name: tensor.contiguous() for name, tensor in ask().items()}
        facts = {"views": [stem(view) for view in views], "question": [str(q) for q in question]}
        cache.save(key, found, pictures(found), facts)
    return found


def stem(view: TrainingView) -> str:
    """A view's name without a file's ending, for names of pictures."""
    return view.name.partition(".")[0]


def _content(view: TrainingView) -> tuple[Tensor | None, ...]:
    """Everything of a view that an estimate may depend on."""
    camera = view.camera
    return view.image, view.mask, view.alpha, camera.world_to_camera, camera.intrinsics
