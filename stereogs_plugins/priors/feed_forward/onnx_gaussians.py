"""`onnx_gaussians`: the Gaussians of each photograph from SHARP in an ONNX file.

SHARP (Mescheder et al., 2025) answers in normalized device coordinates: with the intrinsics fx, fy, cx, cy of
an image of W x H pixels, a point (x, y, z) of the camera is at

    (2 fx / W x + (2 cx / W - 1) z,  2 fy / H y + (2 cy / H - 1) z,  z)

Its unit is a metre by estimate. The unit of the scene is the one with which the other photographs show the
colours of this one at the projected means.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any

from pydantic import Field

from registry import Context, PluginError, PointCloud, Register, TrainingView, hookimpl
from registry.priors import GaussiansPrior
from registry.toolkit.networks import OnnxModel, OnnxModelSettings
from registry.toolkit.progress import tracked

if TYPE_CHECKING:
    from torch import Tensor

IMAGE, DISPARITY_FACTOR = "image", "disparity_factor"
OUTPUTS = {"mean_vectors": 3, "singular_values": 3, "quaternions": 4, "colors": 3, "opacities": 1}
"""Numbers of each Gaussian: quaternions have w first, and colours are linear."""
_COMPARED = 20_000
"""About how many Gaussians of a photograph are compared with the others."""
_DIFFERENT = 0.25
"""Difference of colours, of 1, from which pixels count as occluded."""
_NEIGHBORS = 3
"""Number of other photographs that are compared, the nearest ones."""
_STEPS = 100
"""Number of units that are tried, first between the bounds, then around the best."""


class OnnxGaussiansSettings(OnnxModelSettings):
    views: int | None = Field(None, ge=1)
    """Number of photographs, from the first, that give Gaussians, SHARP about 1.2 million each; null: all."""


class OnnxGaussians(GaussiansPrior[OnnxGaussiansSettings]):
    """Gaussians of each photograph, with their shapes and opacities, in the unit of the scene.

    Raises:
        PluginError: see `OnnxModel`; or the graph has other inputs or outputs.
    """

    def __init__(self, settings: OnnxGaussiansSettings, context: Context) -> None:
        super().__init__(settings, context)
        self._model = settings.open("SHARP (https://github.com/apple/ml-sharp)")
        self._model.input(DISPARITY_FACTOR)
        size = self._model.input(IMAGE).shape[-2:]
        self._size = tuple(side or 1536 for side in size)
        for name in OUTPUTS:
            self._model.output(name)

    @classmethod
    def settings_for(cls, model: OnnxModel) -> Sequence[Mapping[str, Any]]:
        """One candidate, if the graph has the names of SHARP."""
        inputs, outputs = ({spec.name for spec in specs} for specs in (model.inputs, model.outputs))
        known = inputs == {IMAGE, DISPARITY_FACTOR} and outputs >= set(OUTPUTS)
        return [OnnxGaussiansSettings.naming(model)] * known

    def fingerprint(self) -> str:
        """Hash of the model file, and its execution provider."""
        return self._model.fingerprint

    def estimate(self, views: Sequence[TrainingView], bounds: tuple[float, float]) -> PointCloud:
        """Return the Gaussians of all photographs, or of the first ones.

        Raises:
            PluginError: an output has another shape, or no Gaussian is in front of the camera.
        """
        import torch

        parts = []
        for view in tracked(views[: self.settings.views], "Gaussians"):
            cloud = self._of_camera(view)
            to_world = view.camera.camera_to_world.double().clone()
            to_world[:3, :3] *= _unit(cloud.positions, view, views, bounds)
            parts.append(cloud.transformed(to_world))
        names = ("positions", "colors", "scales", "opacities", "quaternions")
        joined: dict[str, Any] = {
            name: torch.cat([getattr(part, name) for part in parts]) for name in names
        }
        return PointCloud(**joined)

    def _of_camera(self, view: TrainingView) -> PointCloud:
        """Gaussians in the camera's coordinates, in the network's unit."""
        import torch
        from kornia.color import linear_rgb_to_rgb

        found = self._run(view)
        means, shapes = _in_camera(
            view, found["mean_vectors"], found["singular_values"], found["quaternions"]
        )
        scales, quaternions = shapes
        kept = means.isfinite().all(dim=1) & scales.isfinite().all(dim=1) & (means[:, 2] > 0)
        if not kept.any():
            raise PluginError(
                "the graph returned no Gaussian in front of the camera",
                where=str(self._model.path),
                fix="export SHARP's predictor alone, which answers in normalized device coordinates",
            )
        colors = linear_rgb_to_rgb(found["colors"].clamp(0, 1).T[:, None])[:, 0].T
        cloud = PointCloud(
            positions=means.float(),
            colors=colors,
            scales=scales.float().clamp(min=torch.finfo(torch.float32).tiny),
            opacities=found["opacities"][:, 0].clamp(1e-6, 1 - 1e-6),
            quaternions=quaternions.float(),
        )
        return cloud.subset(kept)

    def _run(self, view: TrainingView) -> dict[str, Tensor]:
        """Outputs `[N, C]` by name."""
        import torch
        from torch.nn.functional import interpolate

        image = view.image.permute(2, 0, 1)[None]
        image = interpolate(image, self._size, mode="bilinear", align_corners=True)
        factor = torch.tensor([view.camera.fx / view.camera.width])
        answers = self._model.run({IMAGE: image, DISPARITY_FACTOR: factor})
        count = answers["mean_vectors"].numel() // 3
        found = {}
        for name, channels in OUTPUTS.items():
            if answers[name].numel() != count * channels:
                raise PluginError(
                    f"the output {name!r} has the shape {list(answers[name].shape)}, "
                    f"expected [1, {count}, {channels}]",
                    where=str(self._model.path),
                    fix="export SHARP's predictor with its own outputs",
                )
            found[name] = answers[name].reshape(count, channels)
        return found


def _in_camera(
    view: TrainingView, means: Tensor, scales: Tensor, quaternions: Tensor
) -> tuple[Tensor, tuple[Tensor, Tensor]]:
    """Means, and standard deviations and quaternions, from normalized device coordinates to the camera's."""
    import torch
    from scipy.spatial.transform import Rotation

    camera = view.camera
    device = torch.eye(3, dtype=torch.float64)
    device[0, 0], device[0, 2] = 2 * camera.fx / camera.width, 2 * camera.cx / camera.width - 1
    device[1, 1], device[1, 2] = 2 * camera.fy / camera.height, 2 * camera.cy / camera.height - 1
    linear = torch.linalg.inv(device)
    turns = Rotation.from_quat(quaternions[:, [1, 2, 3, 0]].double().numpy()).as_matrix()
    axes = linear @ torch.from_numpy(turns) * scales.double()[:, None]
    # The axes of linear * covariance * linear^T, of which the former are a square root.
    variances, turned = torch.linalg.eigh(axes @ axes.mT)
    turned[:, :, 0] *= torch.linalg.det(turned).sign()[:, None]
    wxyz = torch.from_numpy(Rotation.from_matrix(turned.numpy()).as_quat()).roll(1, dims=1)
    return means.double() @ linear.T, (variances.clamp(min=0).sqrt(), wxyz)


def _unit(
    points: Tensor,
    view: TrainingView,
    views: Sequence[TrainingView],
    bounds: tuple[float, float],
) -> float:
    """World units per unit of the points `[P, 3]` of a camera.

    Without another view that shows them, the geometric mean of the bounds is that of the median depth.
    """
    points = points[:: max(1, len(points) // _COMPARED)].double()
    others = sorted(
        (other for other in views if other is not view),
        key=lambda other: float((other.camera.center - view.camera.center).norm()),
    )[:_NEIGHBORS]
    low, high = (bound / float(points[:, 2].median()) for bound in bounds)
    step = (high / low) ** (1 / _STEPS)

    def best(units: list[float]) -> float:
        errors = [_difference(points * unit, view, others) for unit in units]
        least = min(errors)
        return units[errors.index(least)] if math.isfinite(least) else math.sqrt(low * high)

    nearest = best([low * step**k for k in range(_STEPS + 1)])
    if not others:
        return nearest
    return best([nearest * step ** (2 * k / _STEPS - 1) for k in range(_STEPS + 1)])


def _difference(points: Tensor, view: TrainingView, others: Sequence[TrainingView]) -> float:
    """Mean difference between the colours of points in one view and in the others; inf if these show few."""
    import torch

    world = points @ view.camera.camera_to_world[:3, :3].T.double()
    world += view.camera.camera_to_world[:3, 3]
    shown, there = _colors(world, view)
    differences = []
    for other in others:
        seen, inside = _colors(world, other)
        both = there & inside
        if both.double().mean() > 0.2:
            found = (seen - shown)[both].abs().mean(dim=1)
            differences.append(found.clamp(max=_DIFFERENT).mean())
    return float(torch.stack(differences).mean()) if differences else float("inf")


def _colors(world: Tensor, view: TrainingView) -> tuple[Tensor, Tensor]:
    """Colours `[P, 3]` of a photograph at projected points, and whether they are inside."""
    u, v, z = view.camera.project(world)
    inside = view.camera.contains(u, v) & (z > 0)
    height, width = view.image.shape[:2]
    columns, rows = u.nan_to_num().clamp(0, width - 1), v.nan_to_num().clamp(0, height - 1)
    return view.image[rows.long(), columns.long()], inside


@hookimpl
def stereogs_register_priors(register: Register[OnnxGaussians]) -> None:
    register("onnx_gaussians", OnnxGaussians)
