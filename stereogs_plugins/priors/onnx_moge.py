"""`onnx_moge`: metric depth, intrinsics and normals of one image from MoGe-2 in an ONNX file.

MoGe (Wang et al., CVPR 2025) answers points with an unknown shift along the optical axis. The shift t and the
focal length f are those with which the points project to their pixels (u, v), measured from the image centre:

    minimize over t, f the sum of |f (x, y) / (z + t) - (u, v)|²
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from pydantic import Field

from registry import Context, PluginError, Register, hookimpl
from registry.priors import MonocularDepth, MonocularDepthPrior
from registry.toolkit.networks import OnnxModel, OnnxModelSettings

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence

    from torch import Tensor

IMAGE, TOKENS, POINTS = "image", "num_tokens", "points"
NORMAL, MASK, SCALE = "normal", "mask", "metric_scale"
_SAMPLED = 4096
"""About how many pixels the focal length and the shift are computed from."""


class OnnxMogeSettings(OnnxModelSettings):
    num_tokens: int = Field(1800, ge=1)
    """Number of image patches that the network sees: more are finer and slower."""
    min_mask: float = Field(0.5, ge=0, le=1)
    """Pixels with a lower value of the mask are invalid, for example the sky."""


class OnnxMoge(MonocularDepthPrior[OnnxMogeSettings]):
    """Depth in metres, or up to a factor if the graph has no `metric_scale`.

    Raises:
        PluginError: see `OnnxModel`; or the graph has other inputs or outputs.
    """

    def __init__(self, settings: OnnxMogeSettings, context: Context) -> None:
        super().__init__(settings, context)
        self._model = settings.open("MoGe-2 (https://github.com/microsoft/MoGe)")
        self._tokens = self._model.input(TOKENS)
        self._model.input(IMAGE)
        self._model.output(POINTS)

    @classmethod
    def settings_for(cls, model: OnnxModel) -> Sequence[Mapping[str, Any]]:
        """One candidate, if the graph has the names of MoGe-2."""
        inputs, outputs = ({spec.name for spec in specs} for specs in (model.inputs, model.outputs))
        return [OnnxMogeSettings.naming(model)] * (inputs == {IMAGE, TOKENS} and POINTS in outputs)

    def fingerprint(self) -> str:
        """Hash of the model file, and its execution provider."""
        return self._model.fingerprint

    def estimate(self, image: Tensor) -> MonocularDepth:
        """Return depth, and what else the graph answers, of an image `[H, W, 3]`.

        Raises:
            PluginError: an output has another shape, or no camera fits the points.
        """
        import torch

        tokens = torch.full([size or 1 for size in self._tokens.shape], self.settings.num_tokens)
        batch = {IMAGE: image.permute(2, 0, 1)[None], TOKENS: tokens.float()}
        answers = self._model.run(batch)
        height, width = int(image.shape[0]), int(image.shape[1])
        points = self._shaped(POINTS, answers, (height, width, 3))
        valid = points.isfinite().all(dim=2)
        if MASK in answers:
            valid &= self._shaped(MASK, answers, (height, width)) >= self.settings.min_mask
        focal, shift = self._camera(points, valid)
        scale = float(answers[SCALE].reshape(-1)[0]) if SCALE in answers else 1.0
        intrinsics = [[focal, 0, width / 2], [0, focal, height / 2], [0, 0, 1]]
        return MonocularDepth(
            (points[..., 2] + shift) * scale,
            inverse=False,
            ambiguity="metric" if SCALE in answers else "scale",
            valid=valid,
            intrinsics=torch.tensor(intrinsics),
            normals=self._normals(answers, points, shift) if NORMAL in answers else None,
        )

    def _camera(self, points: Tensor, valid: Tensor) -> tuple[float, float]:
        """Focal length in pixels, and the shift."""
        import scipy.optimize
        import torch

        height, width = valid.shape
        v, u = torch.meshgrid(torch.arange(height), torch.arange(width), indexing="ij")
        pixels = torch.stack([u + 0.5 - width / 2, v + 0.5 - height / 2], dim=2)
        step = max(1, int(valid.sum()) // _SAMPLED)
        x, y, z = points[valid][::step].double().numpy().T
        target = pixels[valid][::step].double().numpy().T
        if len(z) < 3:
            raise self._no_camera("fewer than three points are valid")

        def rays(shift: float) -> Any:
            return [x, y] / (z + shift)

        def focal(shift: float) -> float:
            return float((rays(shift) * target).sum() / (rays(shift) ** 2).sum())

        nearest = float(z.min())
        start = max(0.0, 0.1 * (float(z.max() - nearest) or 1.0) - nearest)
        solve: Any = scipy.optimize.least_squares
        found = solve(
            lambda shift: (focal(shift[0]) * rays(shift[0]) - target).ravel(),
            [start],
            bounds=(-nearest, float("inf")),
            x_scale="jac",
        )
        shift = float(found.x[0])
        if not 0 < focal(shift) < float("inf"):
            raise self._no_camera(f"the focal length would be {focal(shift):g} pixels")
        return focal(shift), shift

    def _normals(self, answers: Mapping[str, Tensor], points: Tensor, shift: float) -> Tensor:
        """Normals towards the camera, which some exports return the other way."""
        height, width, _ = points.shape
        normals = self._shaped(NORMAL, answers, (height, width, 3))
        seen = points + points.new_tensor([0.0, 0.0, shift])
        return normals.where((normals * seen).sum(dim=2, keepdim=True) <= 0, -normals)

    def _shaped(self, name: str, answers: Mapping[str, Tensor], shape: tuple[int, ...]) -> Tensor:
        answer = answers[name]
        if tuple(answer.shape) != (1, *shape):
            raise PluginError(
                f"the output {name!r} has the shape {list(answer.shape)}, expected {[1, *shape]}",
                where=str(self._model.path),
                fix="export the graph with outputs at the image's size",
            )
        return answer[0]

    def _no_camera(self, why: str) -> PluginError:
        return PluginError(
            f"no camera fits the points: {why}",
            where=str(self._model.path),
            fix="check that the graph returns points [1, H, W, 3] of an image in 0..1",
        )


@hookimpl
def stereogs_register_priors(register: Register[OnnxMoge]) -> None:
    register("onnx_moge", OnnxMoge)
