"""`spz`: Niantic's compressed format, about a sixth of the PLY's size."""

from __future__ import annotations

import logging
import math
from dataclasses import replace
from typing import TYPE_CHECKING

from registry import Exporter, Frame, Register, Scene, Settings, hookimpl

if TYPE_CHECKING:
    from pathlib import Path

    from core_rasterizer import GaussianReader, Gaussians

_log = logging.getLogger(__name__)

_FRACTIONAL_BITS = 12
"""The publisher's own choice, which some readers require."""
_REACH = 2047
"""Largest coordinate of 24 bits in steps of 1/4096."""
_LOG_SCALES = (-10.0, 5.9)
"""What the format can hold."""
_SCALE_MARGIN, _POSITION_MARGIN = 2.0, 1.5
"""Logarithms of factors: of the typical scale from those limits, and from the positions' step."""
_ODD_IN_Y_PLUS_Z = (1, 2, 4, 7, 9, 11, 12, 14)
"""Coefficients of spherical harmonics up to degree 3 whose sign changes if y and z are negated."""


class SpzExporter(Exporter[Settings]):
    """Writes scene.spz, version 3: positions to 1/4096 world units, other parameters in 8 to 10 bits.

    The format's axes are x right, y up, z back: the scene is rotated by 180 degrees about x, and readers
    rotate it back. A scene whose coordinates the format cannot hold gets another origin and unit, and a
    warning names them. Gaussians that are still too far away, such as a sky's, are brought nearer.
    """

    def export(self, model: GaussianReader, scene: Scene, folder: Path) -> list[Path]:
        """Write the file and return its path."""
        from registry.toolkit import spz_bytes

        path, gaussians = folder / "scene.spz", model.gaussians()
        if not _fit(gaussians):
            frame = Frame.around(gaussians)
            gaussians = frame.gaussians_of_file(gaussians)
            _log.warning(
                "%s: the format cannot hold the scene's coordinates. The file's origin is the scene's "
                "point (%s), and its unit is %g of the scene's",
                *(path, ", ".join(f"{value:.9g}" for value in frame.center), frame.unit),
            )
            if not _fit(gaussians):
                gaussians = _within_reach(gaussians, path)
        path.write_bytes(spz_bytes(half_turned(gaussians), _FRACTIONAL_BITS))
        return [path]


def _fit(gaussians: Gaussians) -> bool:
    """Return whether positions in steps of 1/4096 and log-scales from -10 to 5.9 hold these Gaussians."""
    typical = float(gaussians.log_scales.median())
    low, high = _LOG_SCALES[0] + _SCALE_MARGIN, _LOG_SCALES[1] - _SCALE_MARGIN
    reach = float(gaussians.means.abs().max())
    coarse = math.log(max(2.0**-_FRACTIONAL_BITS, reach * 2.0**-23))
    return low < typical < high and coarse < typical - _POSITION_MARGIN


def _within_reach(gaussians: Gaussians, path: Path) -> Gaussians:
    """Return the Gaussians; those beyond what positions in steps of 1/4096 can hold are brought nearer.

    They shrink in proportion, so that the view from the origin does not change.
    """
    factors = (_REACH / gaussians.means.abs().amax(dim=1)).clamp(max=1)
    moved = int((factors < 1).sum())
    if moved:
        _log.warning(
            "%s: %d of %d Gaussians, farther away than %d units, would make all positions coarse. They are "
            "brought nearer and made smaller in proportion",
            *(path, moved, len(gaussians), _REACH),
        )
    means, log_scales = gaussians.means, gaussians.log_scales
    return replace(
        gaussians,
        means=means * factors[:, None],
        log_scales=log_scales + factors.log()[:, None],
    )


def half_turned(gaussians: Gaussians) -> Gaussians:
    """Return the Gaussians rotated by 180 degrees about the x axis, with unit quaternions.

    Gaussians are symmetric, so that the quaternion (w, x, -y, -z) is equivalent to the product.
    """
    import torch
    from torch.nn.functional import normalize

    from core_rasterizer import Gaussians

    signs = torch.ones(gaussians.sh.shape[1], 1)
    signs[[index for index in _ODD_IN_Y_PLUS_Z if index < len(signs)]] = -1
    return Gaussians(
        means=gaussians.means * gaussians.means.new_tensor([1.0, -1, -1]),
        log_scales=gaussians.log_scales,
        quaternions=normalize(gaussians.quaternions, dim=1) * torch.tensor([1.0, 1, -1, -1]),
        opacity_logits=gaussians.opacity_logits,
        sh=gaussians.sh * signs,
    )


@hookimpl
def stereogs_register_exporters(register: Register[SpzExporter]) -> None:
    register("spz", SpzExporter)
