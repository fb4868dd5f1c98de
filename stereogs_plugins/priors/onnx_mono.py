"""`onnx_mono`: relative inverse depth of one image from a network in an ONNX file."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Literal

from pydantic import Field

from registry import (
    Context,
    MonocularDepthPrior,
    OnnxModelSettings,
    PluginError,
    Register,
    hookimpl,
)

if TYPE_CHECKING:
    from torch import Tensor

    from registry.image_fitting import ValueRange

FamilyName = Literal["dpt", "depth_anything_v2"]


@dataclass(frozen=True)
class MonoFamily:
    """How a family wants its image: its numbers, its short side in pixels, and whole multiples."""

    value_range: ValueRange
    short_side: int
    multiple: int


FAMILIES: dict[FamilyName, MonoFamily] = {
    "dpt": MonoFamily("-1..1", 384, 32),
    "depth_anything_v2": MonoFamily("imagenet", 518, 14),
}


class OnnxMonoSettings(OnnxModelSettings):
    family: FamilyName = "depth_anything_v2"
    """What the network is: how its image is resized and normalized (docs/prior_models.md)."""
    input: str | None = None
    """The graph's name for the image; null: its only input."""
    output: str | None = None
    """The graph's name for the inverse depth; null: its only output."""
    short_side: int | None = Field(None, ge=1)
    """Pixels of the image's shorter side, where the graph leaves it open; null: the family's."""


class OnnxMono(MonocularDepthPrior[OnnxMonoSettings]):
    """A network's relative inverse depth, asked at the network's size, answered at the image's.

    Raises:
        PluginError: see `OnnxModel`; or a graph that does not take one image.
    """

    def __init__(self, settings: OnnxMonoSettings, context: Context) -> None:
        super().__init__(settings, context)
        self._family = FAMILIES[settings.family]
        self._model = settings.open()
        self._input = self._model.input(settings.input)
        self._output = self._model.output(settings.output)
        if len(self._input.shape) != 4 or self._input.shape[1] not in (None, 3):
            raise PluginError(
                f"the input {self._input} takes no image; expected [1, 3, H, W]",
                where=str(self._model.path),
                fix="name the right one with `input`",
            )

    def fingerprint(self) -> str:
        """The model file's hash and what runs it."""
        return self._model.fingerprint

    def estimate(self, image: Tensor) -> Tensor:
        """Relative inverse depth `[H, W]`, larger = nearer.

        Raises:
            PluginError: the graph answers anything but one map.
        """
        from torch.nn.functional import interpolate

        from registry.image_fitting import in_range, stretched

        size = (int(image.shape[0]), int(image.shape[1]))
        short = self.settings.short_side or self._family.short_side
        factor = short / min(size)
        scaled = (round(size[0] * factor), round(size[1] * factor))
        frozen = (self._input.shape[2], self._input.shape[3])
        target = stretched(scaled, frozen, self._family.multiple).target
        fit = stretched(size, target, self._family.multiple)
        batch = fit.apply(image.permute(2, 0, 1)[None], interpolation="bicubic")
        answers = self._model.run({self._input.name: in_range(batch, self._family.value_range)})
        answer = answers[self._output.name]
        if answer.ndim not in (3, 4) or any(side != 1 for side in answer.shape[:-2]):
            raise PluginError(
                f"the output {self._output.name!r} has the shape {list(answer.shape)}, "
                "expected [1, H, W] or [1, 1, H, W]",
                where=str(self._model.path),
                fix="name the inverse depth with `output`",
            )
        # Values have no unit, so a network may answer at a size of its own.
        maps = answer.reshape(1, 1, *answer.shape[-2:])
        return interpolate(maps, size, mode="bilinear")[0, 0]


@hookimpl
def stereogs_register_priors(register: Register[OnnxMono]) -> None:
    register("onnx_mono", OnnxMono)
