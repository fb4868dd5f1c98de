"""`onnx_flow`: optical flow from a network in an ONNX file.

Follows RAFT's interface (Teed and Deng, ECCV 2020), which FlowFormer++ and SEA-RAFT share. Tested on
synthetic graphs of that form only, not with the weights of a network.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any, get_args

from pydantic import Field

from registry import Context, PluginError, Register, hookimpl
from registry.priors import OpticalFlowPrior
from registry.toolkit.networks import OnnxModel, OnnxModelSettings
from registry.toolkit.networks.image_fitting import ValueRange
from registry.toolkit.views import flow_cycle_error, flow_in_size

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence

    from torch import Tensor


class OnnxFlowSettings(OnnxModelSettings):
    first: str | None = None
    """Input for the first image; null: the graph's first input."""
    second: str | None = None
    """Input for the second image; null: the graph's second input."""
    output: str | None = None
    """Output with the flow; null: the graph's only output."""
    value_range: ValueRange = "0..255"
    """Range of the graph's pixel values, from black to white."""
    multiple: int = Field(8, ge=1)
    """Both sides of an image are padded to a multiple of this, if the graph's size is dynamic."""
    max_cycle_error: float | None = Field(1.0, gt=0)
    """Largest distance in pixels between a pixel and the end of the flow there and back; larger ones are
    unknown. null keeps all vectors, including those of occluded pixels, and runs the graph once."""


class OnnxFlow(OpticalFlowPrior[OnnxFlowSettings]):
    """Flow of a network; images are padded, and shrunk for a graph with a smaller fixed size.

    Raises:
        PluginError: see `OnnxModel`; or the graph does not take two images.
    """

    def __init__(self, settings: OnnxFlowSettings, context: Context) -> None:
        super().__init__(settings, context)
        self._model = settings.open()
        if len(self._model.inputs) != 2:
            raise PluginError(
                f"the graph has {len(self._model.inputs)} inputs, optical flow needs two images",
                where=str(self._model.path),
                fix="use the ONNX file of a flow network",
            )
        first, second = self._model.inputs
        self._first = self._model.input(settings.first) if settings.first else first
        self._second = self._model.input(settings.second) if settings.second else second
        for spec in (self._first, self._second):
            if len(spec.shape) != 4 or spec.shape[1] not in (None, 3):
                raise PluginError(
                    f"the input {spec} is not an image; expected [1, 3, H, W]",
                    where=str(self._model.path),
                    fix="set `first` and `second` to the image inputs",
                )
        self._output = self._model.output(settings.output)

    @classmethod
    def settings_for(cls, model: OnnxModel) -> Sequence[Mapping[str, Any]]:
        """All value ranges, for a graph that maps two images to two numbers per pixel."""
        images = [len(spec.shape) == 4 and spec.shape[1] == 3 for spec in model.inputs]
        flows = [s.name for s in model.outputs if len(s.shape) == 4 and s.shape[1] == 2]
        if images != [True, True]:
            return []
        return [
            {**OnnxFlowSettings.naming(model), "output": output, "value_range": value_range}
            for output in flows
            for value_range in get_args(ValueRange)
        ]

    def fingerprint(self) -> str:
        """Hash of the model file, and its execution provider."""
        return self._model.fingerprint

    def estimate(self, first: Tensor, second: Tensor) -> Tensor:
        """Flow `[H, W, 2]` in pixels; not finite where it fails the cycle check.

        Raises:
            PluginError: the graph does not return two maps of its input's size.
        """
        from registry.toolkit.networks.image_fitting import stretched

        size, other = ((int(image.shape[0]), int(image.shape[1])) for image in (first, second))
        # The second image is resized to the size of the first.
        there = stretched(other, size, 1).apply(second.permute(2, 0, 1)[None])
        here = first.permute(2, 0, 1)[None]
        flow = self._infer(here, there)
        if self.settings.max_cycle_error is not None:
            error = flow_cycle_error(flow, self._infer(there, here))
            flow = flow.where(error[..., None] <= self.settings.max_cycle_error, float("nan"))
        return flow if other == size else flow_in_size(flow, other).float()

    def _infer(self, first: Tensor, second: Tensor) -> Tensor:
        """Flow `[H, W, 2]` between images `[1, 3, H, W]`."""
        import torch

        from registry.toolkit.networks.image_fitting import in_range, padded

        size = (int(first.shape[2]), int(first.shape[3]))
        frozen = (self._first.shape[2], self._first.shape[3])
        fit = padded(size, frozen, self.settings.multiple)
        images = [
            in_range(fit.apply(image), self.settings.value_range) for image in (first, second)
        ]
        answers = self._model.run({self._first.name: images[0], self._second.name: images[1]})
        answer = answers[self._output.name]
        if tuple(answer.shape) != (1, 2, *fit.target):
            raise PluginError(
                f"the output {self._output.name!r} has the shape {list(answer.shape)}, "
                f"expected [1, 2, {fit.target[0]}, {fit.target[1]}]",
                where=str(self._model.path),
                fix="set `output` to the flow at full size",
            )
        along_rows, along_columns = fit.undo(answer[0])
        return torch.stack(
            [along_rows * fit.width_factor, along_columns * fit.height_factor], dim=2
        )


@hookimpl
def stereogs_register_priors(register: Register[OnnxFlow]) -> None:
    register("onnx_flow", OnnxFlow)
