"""`onnx_mono`: relative inverse depth of one image from a network in an ONNX file."""

from __future__ import annotations

from dataclasses import dataclass, fields, replace
from typing import TYPE_CHECKING, Any, Literal, get_args

from pydantic import Field

from registry import Context, PluginError, Register, hookimpl
from registry.priors import MonocularDepthPrior
from registry.toolkit.networks import OnnxModel, OnnxModelSettings, OnnxTensor
from registry.toolkit.networks.image_fitting import ValueRange

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence

    from torch import Tensor

FamilyName = Literal["dpt", "depth_anything_v2"]
Answer = Literal["inverse_depth", "depth"]
MIN_DEPTH = 1e-3
"""Least depth relative to the median of a network's depths; smaller ones are clamped."""


@dataclass(frozen=True)
class MonoFamily:
    """Input and output format of a family: pixel values, short side and its multiple in pixels, output.

    `published` names the network and the address of its weights.
    """

    value_range: ValueRange
    short_side: int
    multiple: int
    published: str
    answers: Answer = "inverse_depth"


FAMILIES: dict[FamilyName, MonoFamily] = {
    "dpt": MonoFamily("-1..1", 384, 32, "DPT (https://github.com/isl-org/DPT)"),
    "depth_anything_v2": MonoFamily(
        "imagenet",
        518,
        14,
        "Depth Anything V2 (https://github.com/DepthAnything/Depth-Anything-V2)",
    ),
}


class OnnxMonoSettings(OnnxModelSettings):
    family: FamilyName = "depth_anything_v2"
    """Network family; gives the values of settings below that are null (docs/prior_models.md)."""
    input: str | None = None
    """Input for the image; null: the graph's only input."""
    output: str | None = None
    """Output with the map; null: the graph's only output."""
    short_side: int | None = Field(None, ge=1)
    """Shorter side of the input in pixels, if the graph's size is dynamic."""
    multiple: int | None = Field(None, ge=1)
    """Both sides are rounded to a multiple of this, if the graph's size is dynamic."""
    value_range: ValueRange | None = None
    """Range of the graph's pixel values, from black to white."""
    answers: Answer | None = None
    """Output of the graph: relative inverse depth, or depth in any unit, larger = farther."""


class OnnxMono(MonocularDepthPrior[OnnxMonoSettings]):
    """Relative inverse depth of a network, inferred at the network's size and resized to the image's.

    Raises:
        PluginError: see `OnnxModel`; or the graph does not take one image.
    """

    def __init__(self, settings: OnnxMonoSettings, context: Context) -> None:
        super().__init__(settings, context)
        self._family = _family(settings)
        self._model = settings.open(self._family.published)
        self._input = self._model.input(settings.input)
        self._output = self._model.output(settings.output)
        if len(self._input.shape) != 4 or self._input.shape[1] not in (None, 3):
            raise PluginError(
                f"the input {self._input} is not an image; expected [1, 3, H, W]",
                where=str(self._model.path),
                fix="set `input` to the image input",
            )

    @classmethod
    def settings_for(cls, model: OnnxModel) -> Sequence[Mapping[str, Any]]:
        """Each family and value range, as depth and as inverse depth, for a graph from one image to maps."""
        image = model.inputs[0]
        maps = [{"output": spec.name} for spec in model.outputs if _is_map(spec)]
        outputs: list[dict[str, str]] = [{}] if len(model.outputs) == len(maps) == 1 else maps
        if len(model.inputs) != 1 or len(image.shape) != 4 or image.shape[1] != 3:
            return []
        kinds: list[dict[str, str]] = [{"family": name} for name in FAMILIES]
        kinds += [{"family": "dpt", "value_range": numbers} for numbers in ("0..1", "0..255")]
        return [
            {**OnnxMonoSettings.naming(model), **kind, **output, "answers": answers}
            for output in outputs
            for kind in kinds
            for answers in get_args(Answer)
        ]

    def fingerprint(self) -> str:
        """Hash of the model file, and its execution provider."""
        return self._model.fingerprint

    def estimate(self, image: Tensor) -> Tensor:
        """Relative inverse depth `[H, W]`, larger = nearer.

        Raises:
            PluginError: the graph does not return one map, or returns no depth above 0.
        """
        from torch.nn.functional import interpolate

        from registry.toolkit.networks.image_fitting import in_range, stretched

        size = (int(image.shape[0]), int(image.shape[1]))
        factor = self._family.short_side / min(size)
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
                fix="set `output` to the map",
            )
        if self._family.answers == "depth":
            answer = self._inverted(answer)
        # Values have no unit, so the output may have any size.
        maps = answer.reshape(1, 1, *answer.shape[-2:])
        return interpolate(maps, size, mode="bilinear")[0, 0]

    def _inverted(self, depth: Tensor) -> Tensor:
        import torch

        known = depth[torch.isfinite(depth) & (depth > 0)]
        if not len(known):
            raise PluginError(
                "the graph returned no depth above 0",
                where=str(self._model.path),
                fix="remove `answers` if the graph returns inverse depth; check `value_range`",
            )
        return 1 / depth.clamp(min=MIN_DEPTH * float(known.median()))


def _is_map(spec: OnnxTensor) -> bool:
    return len(spec.shape) == 3 or (len(spec.shape) == 4 and spec.shape[1] == 1)


def _family(settings: OnnxMonoSettings) -> MonoFamily:
    """The family, overridden by the settings that are not null."""
    overrides = {
        field.name: value
        for field in fields(MonoFamily)
        if (value := getattr(settings, field.name, None)) is not None
    }
    return replace(FAMILIES[settings.family], **overrides)


@hookimpl
def stereogs_register_priors(register: Register[OnnxMono]) -> None:
    register("onnx_mono", OnnxMono)
