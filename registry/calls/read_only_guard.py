"""What components are shown and must leave as it is.

torch counts the writes into a tensor, so that every call is held to that for nothing. What writes past
torch, through numpy or `.data`, is found by comparing every bit: `checked_plugins`.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from contextvars import ContextVar
from typing import TYPE_CHECKING

from ..errors import PluginError

if TYPE_CHECKING:
    from torch import Tensor

    from core_rasterizer import Camera, GaussianModel, Rendering

    from ..contract.maps import DepthMap
    from ..contract.scene import Scene, TrainingScene, TrainingView

_CHECKED: ContextVar[bool] = ContextVar("checked", default=False)


class Overwritten(PluginError):
    """A component wrote into what it was lent: whatever others make of that now would be wrong."""


class ReadOnlyGuard:
    """Tensors that a component may look at.

    Args:
        tensors: by what they are called in messages.
        models: Gaussians, compared around each call.
        renderings: whose images are not fetched for this.
    """

    def __init__(
        self,
        tensors: Mapping[str, Tensor] | None = None,
        models: tuple[GaussianModel, ...] = (),
        renderings: tuple[Rendering, ...] = (),
    ) -> None:
        self._tensors, self._models = dict(tensors or {}), models
        self._renderings = renderings

    def __add__(self, other: ReadOnlyGuard) -> ReadOnlyGuard:
        return ReadOnlyGuard(
            self._tensors | other._tensors,
            self._models + other._models,
            self._renderings + other._renderings,
        )

    @contextmanager
    def kept(self) -> Iterator[None]:
        """Refuse a block that writes into something lent.

        Raises:
            Overwritten: names the first.
        """
        tensors = self._tensors | self._images(fetch=are_checked())
        marks = {name: _mark(tensor) for name, tensor in tensors.items()}
        copies = _copies(tensors) if are_checked() else {}
        gaussians = [model.parameters.read().clone() for model in self._models]
        yield
        for name, tensor in (self._tensors | self._images()).items():
            # An image that was fetched meanwhile had never been written to.
            mark = marks.get(name, (0, tensor.requires_grad))
            if _mark(tensor) != mark or (copies and not _same(tensor, copies[name])):
                raise _written(name)
        for model, before in zip(self._models, gaussians, strict=True):
            if not _same(model.parameters.read(), before):
                raise _written("the Gaussians")

    def _images(self, fetch: bool = False) -> dict[str, Tensor]:
        """The images of the renderings: those that somebody has asked for, or all."""
        images: dict[str, Tensor] = {}
        for rendering in self._renderings:
            if fetch:
                _ = rendering.rgb, rendering.depth, rendering.alpha
            images |= {f"the rendered {name}": image for name, image in rendering.fetched.items()}
        return images


NOTHING = ReadOnlyGuard()


@contextmanager
def checked_plugins(wanted: bool = True) -> Iterator[None]:
    """Within the block every bit that components are lent is compared around each call.

    Each call takes longer by a copy and a comparison of the scene and the Gaussians.
    """
    token = _CHECKED.set(wanted)
    try:
        yield
    finally:
        _CHECKED.reset(token)


def are_checked() -> bool:
    """Whether this is within `checked_plugins`."""
    return _CHECKED.get()


def of_scene(scene: Scene | TrainingScene) -> ReadOnlyGuard:
    """The photographs, masks, depths, cameras and points of a scene; of test views if it has any."""
    tensors: dict[str, Tensor] = {}
    test = vars(scene).get("test", ())
    for view in (*scene.train, *test):
        tensors |= _of_view(view)
    for name, value in vars(scene.points).items() if scene.points else ():
        if name in ("positions", "colors", "scales", "opacities") and value is not None:
            tensors[f"the {name} of the scene's points"] = value
    return ReadOnlyGuard(tensors)


def of_view(view: TrainingView) -> ReadOnlyGuard:
    """One view's photograph, mask, alpha, depth and camera."""
    return ReadOnlyGuard(_of_view(view))


def of_rendering(rendering: Rendering) -> ReadOnlyGuard:
    """What was rendered."""
    return ReadOnlyGuard(renderings=(rendering,))


def of_kinds(kinds: Mapping[str, Tensor]) -> ReadOnlyGuard:
    """Which Gaussians descend from which kind of initial point."""
    return ReadOnlyGuard({f"which Gaussians are {kind}": mask for kind, mask in kinds.items()})


def of_maps(maps: Mapping[str, DepthMap]) -> ReadOnlyGuard:
    """The initializer's depth of the training views."""
    return ReadOnlyGuard(
        {
            f"the initializer's {kind} of {name}": value
            for name, known in maps.items()
            for kind, value in vars(known).items()
        }
    )


_OF_VIEW = {"image": "photograph", "mask": "mask", "alpha": "alpha", "depth": "depth"}


def _of_view(view: TrainingView) -> dict[str, Tensor]:
    camera: Camera = view.camera
    tensors = {f"the camera of {view.name}": camera.world_to_camera}
    for field, called in _OF_VIEW.items():
        value = vars(view).get(field)
        if value is not None:
            tensors[f"the {called} of {view.name}"] = value
    return tensors


def _mark(tensor: Tensor) -> tuple[int, bool]:
    """What changes with every write through torch."""
    return (0 if tensor.is_inference() else tensor._version), tensor.requires_grad


def _same(tensor: Tensor, copy: Tensor) -> bool:
    """Whether two tensors hold the same numbers; NaN is equal to itself."""
    import torch

    return torch.equal(tensor, copy) or (
        tensor.shape == copy.shape
        and tensor.is_floating_point()
        and torch.allclose(tensor, copy, rtol=0, atol=0, equal_nan=True)
    )


def _copies(tensors: Mapping[str, Tensor]) -> dict[str, Tensor]:
    return {name: tensor.detach().clone() for name, tensor in tensors.items()}


def _written(name: str) -> Overwritten:
    return Overwritten(
        f"it wrote into {name}, which it may only look at",
        fix="work on a copy (`tensor.clone()`), and return what is to change",
    )
