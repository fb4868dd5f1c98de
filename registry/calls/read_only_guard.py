"""Data that components may read but not write.

torch counts the writes into a tensor, so checking each call is cheap. Writes that bypass torch, through numpy
or `.data`, are only found by comparing every bit; `policy` says when.
"""

from __future__ import annotations

from collections.abc import Callable, Collection, Iterable, Mapping
from dataclasses import dataclass, field
from operator import attrgetter
from typing import TYPE_CHECKING

from ..errors import PluginError

if TYPE_CHECKING:
    from torch import Tensor

    from core_rasterizer import Model, Rendering

    from ..contract.scene import DepthMap, Scene, TrainingScene
    from ..contract.step import Sample

_Mark = tuple[int, bool, object]
_mark: Callable[[Tensor], _Mark] = attrgetter("_version", "requires_grad", "_backward_hooks")
"""Values that change with every write through torch, and with a first hook."""


@dataclass(frozen=True, eq=False)
class ReadOnlyGuard:
    """Data that a component may only read.

    Args:
        tensors: by their names in messages.
        models: Gaussians, which must get no gradient either.
        renderings: renders; the guard does not fetch images that nobody else fetches.
    """

    tensors: Mapping[str, Tensor] = field(default_factory=dict)
    models: tuple[Model, ...] = ()
    renderings: tuple[Rendering, ...] = ()

    def __add__(self, other: ReadOnlyGuard) -> ReadOnlyGuard:
        if self is NOTHING or other is NOTHING:
            return other if self is NOTHING else self
        return ReadOnlyGuard(
            {**self.tensors, **other.tensors},
            self.models + other.models,
            self.renderings + other.renderings,
        )

    def kept(self, *, every_bit: bool = False) -> _Kept:
        """Refuse a block that writes into the data, runs a backward pass or registers a hook.

        Args:
            every_bit: also find writes that bypass torch, and writes into the Gaussians.

        Raises:
            PluginError: names the first.
        """
        return _Kept(self, every_bit)

    def _images(self, fetch: bool = False) -> dict[str, Tensor]:
        """Return the fetched images of the renderings, or fetch and return all."""
        images: dict[str, Tensor] = {}
        for rendering in self.renderings:
            if fetch:
                _ = rendering.rgb, rendering.depth, rendering.alpha
            images |= {f"the rendered {name}": image for name, image in rendering.fetched.items()}
        return images


class _Kept:
    """The context of `ReadOnlyGuard.kept`."""

    __slots__ = ("_copies", "_every_bit", "_gaussians", "_guard", "_marks", "_passes", "_tensors")

    def __init__(self, guard: ReadOnlyGuard, every_bit: bool) -> None:
        self._guard, self._every_bit = guard, every_bit

    def __enter__(self) -> None:
        guard = self._guard
        self._tensors: Mapping[str, Tensor] = guard.tensors
        if guard.renderings:
            self._tensors = {**guard.tensors, **guard._images(fetch=self._every_bit)}
        self._marks = _marks(self._tensors.values())
        self._passes = [model.backward_passes for model in guard.models]
        if self._every_bit:
            self._copies = [tensor.detach().clone() for tensor in self._tensors.values()]
            self._gaussians = [vars(model.gaussians()) for model in guard.models]

    def __exit__(self, kind: object, error: BaseException | None, trace: object) -> None:
        if error is not None:
            return
        guard, tensors, marks = self._guard, self._tensors, self._marks
        if self._passes != [model.backward_passes for model in guard.models]:
            raise PluginError(
                "it ran a backward pass into the Gaussians: others' gradients would be wrong",
                fix="return the loss, and leave `backward` to the host",
            )
        if guard.renderings:
            # Those fetched within the block come last, with no writes before.
            more = {n: image for n, image in guard._images().items() if n not in tensors}
            tensors = {**tensors, **more}
            marks = marks + [(0, image.requires_grad, None) for image in more.values()]
        after = _marks(tensors.values())
        if after != marks:
            _refuse_change(tensors, marks, after)
        if self._every_bit:
            self._compare_bits()

    def _compare_bits(self) -> None:
        for (name, tensor), copy in zip(self._tensors.items(), self._copies, strict=True):
            if not _same(tensor, copy):
                raise _overwritten(name)
        for model, parameters in zip(self._guard.models, self._gaussians, strict=True):
            if not all(_same(model.read(name), values) for name, values in parameters.items()):
                raise _overwritten("the Gaussians")


NOTHING = ReadOnlyGuard()

_VIEW_TENSORS = {"image": "photograph"} | {
    name: name for name in ("mask", "alpha", "weights", "depth")
}
"""Attributes of views, and their names in messages."""


def of_scene(scene: Scene | TrainingScene) -> ReadOnlyGuard:
    """Guard the views and points of a scene, including test views if it has any."""
    found: dict[str, Tensor | None] = {}
    for view in (*scene.train, *vars(scene).get("test", ())):
        found[f"the camera of {view.name}"] = view.camera.world_to_camera
        for attribute, title in _VIEW_TENSORS.items():
            found[f"the {title} of {view.name}"] = vars(view).get(attribute)
    for name in ("positions", "colors", "scales", "opacities", "quaternions", "sh"):
        found[f"the {name} of the scene's points"] = getattr(scene.points, name, None)
    return ReadOnlyGuard({name: value for name, value in found.items() if value is not None})


def of_rendering(rendering: Rendering) -> ReadOnlyGuard:
    """Guard a render."""
    return ReadOnlyGuard(renderings=(rendering,))


def of_sample(sample: Sample) -> ReadOnlyGuard:
    """Guard the target and the weights of an iteration."""
    weights = {} if sample.weights is None else {"the weights": sample.weights}
    return ReadOnlyGuard({"the target": sample.target, **weights})


def of_kinds(kinds: Mapping[str, Tensor]) -> ReadOnlyGuard:
    """Guard the masks of Gaussians by kind (`Step.kinds`)."""
    return ReadOnlyGuard({f"which Gaussians are {kind}": mask for kind, mask in kinds.items()})


def of_maps(maps: Mapping[str, DepthMap]) -> ReadOnlyGuard:
    """Guard the initializer's depth of training views (`Step.maps`)."""
    return ReadOnlyGuard(
        {
            f"the initializer's {kind} of {name}": value
            for name, known in maps.items()
            for kind, value in vars(known).items()
        }
    )


def _marks(tensors: Collection[Tensor]) -> list[_Mark]:
    try:
        return list(map(_mark, tensors))
    except RuntimeError:  # tensors made in inference mode count no writes
        return [(0, t.requires_grad, None) if t.is_inference() else _mark(t) for t in tensors]


def _refuse_change(names: Iterable[str], marks: list[_Mark], after: list[_Mark]) -> None:
    """Name the first tensor whose mark has changed."""
    for name, before, now in zip(names, marks, after, strict=True):
        if now[2] is not before[2]:
            raise PluginError(
                f"it registered a hook on {name}: others' gradients would be wrong",
                fix="register hooks on a copy, for example `tensor.clone()`",
            )
        if now != before:
            raise _overwritten(name)


def _same(tensor: Tensor, copy: Tensor) -> bool:
    """Whether two tensors hold the same numbers; NaN equals NaN."""
    import torch

    return torch.equal(tensor, copy) or (
        tensor.shape == copy.shape
        and tensor.is_floating_point()
        and torch.allclose(tensor, copy, rtol=0, atol=0, equal_nan=True)
    )


def _overwritten(name: str) -> PluginError:
    return PluginError(
        f"it wrote into {name}, which it may only read",
        fix="work on a copy (`tensor.clone()`), and return the changed values",
    )
