"""`onnx_mono`: depth of one image from a network in an ONNX file: relative inverse depth, depth, or metres.

Metric3D v2 (Hu et al., TPAMI 2024) and Depth Anything 3 Metric return depth as a camera of a canonical
focal length F would see it; a camera of the focal length f, in pixels of the network's image, sees f / F
times that.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, fields, replace
from typing import TYPE_CHECKING, Any, Literal, get_args

from pydantic import Field

from registry import Context, PluginError, PointCloud, Register, TrainingView, hookimpl
from registry.priors import MonocularDepth, MonocularDepthPrior
from registry.toolkit.networks import OnnxModel, OnnxModelSettings, OnnxTensor
from registry.toolkit.networks.image_fitting import Fit, Padding, ValueRange

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence

    from torch import Tensor

FamilyName = Literal["dpt", "depth_anything_v2", "depth_anything_3", "metric3d_v2", "unidepth_v2"]
Answer = Literal["inverse_depth", "depth"]
MIN_DEPTH = 1e-3
"""Depths smaller than this times the median of all are invalid."""
SKY = "sky"
"""Name of an output that is larger in the sky."""
MAX_SKY = 0.3
"""Depth is invalid from this value of the sky on (Depth Anything 3)."""


@dataclass(frozen=True)
class MonoFamily:
    """Input and output format of a family: pixel values, short side and its multiple in pixels, output.

    `published` names the network and the address of its weights.

    Args:
        padding: what surrounds an image of other proportions than the graph's; None: stretch it.
        outputs: names of the output, of which a graph has one; empty: its only output. Of points
            `[1, 3, H, W]`, the last channel is the depth.
        intrinsics: names of the output `[1, 3, 3]` in pixels of the input; depth is then in metres.
        canonical_focal: focal length in pixels with which depth is in metres; None: its unit is unknown.
        recognized: whether a graph with these inputs and outputs, by name, is of this family.
    """

    value_range: ValueRange
    short_side: int
    multiple: int
    published: str
    answers: Answer = "inverse_depth"
    padding: Padding | None = None
    outputs: tuple[str, ...] = ()
    intrinsics: tuple[str, ...] = ()
    canonical_focal: float | None = None
    recognized: Callable[[set[str], set[str]], bool] = lambda inputs, outputs: False


FAMILIES: dict[FamilyName, MonoFamily] = {
    "dpt": MonoFamily("-1..1", 384, 32, "DPT (https://github.com/isl-org/DPT)"),
    "depth_anything_v2": MonoFamily(
        "imagenet",
        518,
        14,
        "Depth Anything V2 (https://github.com/DepthAnything/Depth-Anything-V2)",
    ),
    "depth_anything_3": MonoFamily(
        "imagenet",
        378,
        14,
        "Depth Anything 3 (https://github.com/ByteDance-Seed/Depth-Anything-3)",
        answers="depth",
        outputs=("depth", "predicted_depth"),
        recognized=lambda _, outputs: {SKY, "depth"} <= outputs or "extrinsics" in outputs,
    ),
    "metric3d_v2": MonoFamily(
        "0..255",
        616,
        28,
        "Metric3D v2 (https://github.com/YvanYin/Metric3D)",
        answers="depth",
        padding="mean",
        outputs=("pred_depth",),
        canonical_focal=1000.0,
        recognized=lambda _, outputs: "pred_depth" in outputs,
    ),
    "unidepth_v2": MonoFamily(
        "imagenet",
        462,
        14,
        "UniDepthV2 (https://github.com/lpiccinelli-eth/UniDepth)",
        answers="depth",
        padding="mean",
        outputs=("pts_3d", "depth"),
        intrinsics=("intrinsics", "out_K"),
        recognized=lambda inputs, outputs: (
            (inputs == {"rgbs"} and {"pts_3d", "intrinsics"} <= outputs)
            or {"depth", "out_K"} <= outputs
        ),
    ),
}


class OnnxMonoSettings(OnnxModelSettings):
    family: FamilyName = "depth_anything_v2"
    """Network family; gives the values of settings below that are null (docs/prior_models.md)."""
    input: str | None = None
    """Input for the image; null: the graph's only input."""
    output: str | None = None
    """Output with the map; null: the one of the family's name, or the graph's only output."""
    short_side: int | None = Field(None, ge=1)
    """Shorter side of the input in pixels, if the graph's size is dynamic."""
    multiple: int | None = Field(None, ge=1)
    """Both sides are rounded to a multiple of this, if the graph's size is dynamic."""
    value_range: ValueRange | None = None
    """Range of the graph's pixel values, from black to white."""
    answers: Answer | None = None
    """Output of the graph: relative inverse depth, or depth in any unit, larger = farther."""
    canonical_focal: float | None = Field(None, gt=0, allow_inf_nan=False)
    """Focal length in pixels with which the graph's depth is in metres (Metric3D: 1000, Depth Anything 3
    Metric: 300)."""


class OnnxMono(MonocularDepthPrior[OnnxMonoSettings]):
    """Depth of a network, inferred at the network's size and resized to the image's.

    Raises:
        PluginError: see `OnnxModel`; or the graph does not take one image.
    """

    def __init__(self, settings: OnnxMonoSettings, context: Context) -> None:
        super().__init__(settings, context)
        self._family = _family(settings)
        self._model = settings.open(self._family.published)
        self._input = self._model.input(settings.input)
        given = {spec.name for spec in self._model.outputs}
        usual = next((name for name in self._family.outputs if name in given), None)
        self._output = self._model.output(settings.output or usual)
        self._intrinsics = next((name for name in self._family.intrinsics if name in given), None)
        if not _is_image(self._input, several="extrinsics" in given):
            raise PluginError(
                f"the input {self._input} is not an image; expected [1, 3, H, W]",
                where=str(self._model.path),
                fix="set `input` to the image input",
            )

    @classmethod
    def settings_for(cls, model: OnnxModel) -> Sequence[Mapping[str, Any]]:
        """The family whose names the graph has; or each of the others, as depth and as inverse depth."""
        image, naming = model.inputs[0], OnnxMonoSettings.naming(model)
        if len(model.inputs) != 1 or not _is_image(image):
            return []
        given = {image.name}, {spec.name for spec in model.outputs}
        for name, family in FAMILIES.items():
            if family.recognized(*given):
                return [{**naming, "family": name}]
        maps = [{"output": spec.name} for spec in model.outputs if _is_map(spec)]
        outputs: list[dict[str, str]] = [{}] if len(model.outputs) == len(maps) == 1 else maps
        kinds: list[dict[str, str]] = [{"family": name} for name in ("dpt", "depth_anything_v2")]
        kinds += [{"family": "dpt", "value_range": numbers} for numbers in ("0..1", "0..255")]
        return [
            {**naming, **kind, **output, "answers": answers}
            for output in outputs
            for kind in kinds
            for answers in get_args(Answer)
        ]

    def fingerprint(self) -> str:
        """Hash of the model file, and its execution provider."""
        return self._model.fingerprint

    def estimate(self, image: Tensor) -> Tensor | MonocularDepth:
        """Relative inverse depth `[H, W]`, larger = nearer, or depth.

        Raises:
            PluginError: the graph does not return one map, or returns no depth above 0.
        """
        return self._estimated(image, focal=None)

    def estimate_view(
        self, view: TrainingView, points: PointCloud | None
    ) -> Tensor | MonocularDepth:
        """Like `estimate`; in metres if the family needs no more than the camera's focal length."""
        return self._estimated(view.image, (view.camera.fx + view.camera.fy) / 2)

    def _estimated(self, image: Tensor, focal: float | None) -> Tensor | MonocularDepth:
        from registry.toolkit.networks.image_fitting import in_range

        fit = self._fit((int(image.shape[0]), int(image.shape[1])))
        batch = image.permute(2, 0, 1)[None]
        batch = fit.apply(
            batch, interpolation="bicubic", padding=self._family.padding or "replicate"
        )
        batch = in_range(batch, self._family.value_range)
        given = batch[None] if len(self._input.shape) == 5 else batch
        answers = self._model.run({self._input.name: given})
        answer = self._resized(self._output.name, answers, fit)
        if self._family.answers == "inverse_depth":
            return answer
        return self._depth(answer, answers, fit, focal)

    def _fit(self, size: tuple[int, int]) -> Fit:
        from registry.toolkit.networks.image_fitting import contained, stretched

        factor = self._family.short_side / min(size)
        scaled = (round(size[0] * factor), round(size[1] * factor))
        frozen = (self._input.shape[-2], self._input.shape[-1])
        target = stretched(scaled, frozen, self._family.multiple).target
        if self._family.padding is not None:
            return contained(size, target)
        return stretched(size, target, self._family.multiple)

    def _resized(self, name: str, answers: Mapping[str, Tensor], fit: Fit) -> Tensor:
        """An output as `[H, W]` of the image; of points, the last channel."""
        from torch.nn.functional import interpolate

        answer = answers[name]
        if name == "pts_3d" and answer.ndim == 4:
            answer = answer[:, 2:]
        if answer.ndim not in (3, 4, 5) or any(side != 1 for side in answer.shape[:-2]):
            raise PluginError(
                f"the output {name!r} has the shape {list(answer.shape)}, "
                "expected [1, H, W] or [1, 1, H, W]",
                where=str(self._model.path),
                fix="set `output` to the map",
            )
        maps = answer.reshape(1, 1, *answer.shape[-2:])
        if fit.content != fit.target:  # without the border
            return fit.undo(interpolate(maps, fit.target, mode="bilinear")[0])[0]
        # Depth does not depend on the size of the image, so the output may have any.
        return interpolate(maps, fit.image, mode="bilinear")[0, 0]

    def _depth(
        self, depth: Tensor, answers: Mapping[str, Tensor], fit: Fit, focal: float | None
    ) -> MonocularDepth:
        known = depth[depth.isfinite() & (depth > 0)]
        if not len(known):
            raise PluginError(
                "the graph returned no depth above 0",
                where=str(self._model.path),
                fix="remove `answers` if the graph returns inverse depth; check `value_range`",
            )
        valid = depth > MIN_DEPTH * known.median()
        if SKY in answers:
            valid &= self._resized(SKY, answers, fit) < MAX_SKY
        canonical, lens = self._family.canonical_focal, None
        if canonical is not None and focal is not None:
            depth = depth * (focal / math.sqrt(fit.width_factor * fit.height_factor) / canonical)
        if self._intrinsics is not None:
            lens = fit.undo_intrinsics(answers[self._intrinsics].reshape(3, 3))
        metric = lens is not None or (canonical is not None and focal is not None)
        return MonocularDepth(
            depth,
            inverse=False,
            ambiguity="metric" if metric else "scale",
            valid=valid,
            intrinsics=lens,
        )


def _is_image(spec: OnnxTensor, several: bool = False) -> bool:
    """Whether it is `[1, 3, H, W]` or `[1, 1, 3, H, W]`; or `[1, V, 3, H, W]`, if there may be several."""
    if len(spec.shape) == 5:
        count = spec.shape[1]
        return (count == 1 or (several and count is None)) and spec.shape[2] in (None, 3)
    return len(spec.shape) == 4 and spec.shape[1] in (None, 3)


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
