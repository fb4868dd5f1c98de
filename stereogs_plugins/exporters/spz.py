"""`spz`: Niantic's compressed format, about a sixth of the PLY's size."""

from __future__ import annotations

from typing import TYPE_CHECKING

from registry import Exporter, Register, Scene, Settings, hookimpl

if TYPE_CHECKING:
    from pathlib import Path

    from core_rasterizer import GaussianReader, Gaussians

_FRACTIONAL_BITS = 12
"""The publisher's own choice, which some readers require."""
_ODD_IN_Y_PLUS_Z = (1, 2, 4, 7, 9, 11, 12, 14)
"""Coefficients of spherical harmonics up to degree 3 whose sign changes if y and z are negated."""


class SpzExporter(Exporter[Settings]):
    """Writes scene.spz, version 3: positions to 1/4096 world units, other parameters in 8 to 10 bits.

    The format's axes are x right, y up, z back: the scene is rotated by 180 degrees about x, and readers
    rotate it back.
    """

    def export(self, model: GaussianReader, scene: Scene, folder: Path) -> list[Path]:
        """Write the file and return its path."""
        from registry.toolkit import spz_bytes

        path = folder / "scene.spz"
        path.write_bytes(spz_bytes(half_turned(model.gaussians()), _FRACTIONAL_BITS))
        return [path]


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
        means=gaussians.means * torch.tensor([1.0, -1, -1]),
        log_scales=gaussians.log_scales,
        quaternions=normalize(gaussians.quaternions, dim=1) * torch.tensor([1.0, 1, -1, -1]),
        opacity_logits=gaussians.opacity_logits,
        sh=gaussians.sh * signs,
    )


@hookimpl
def stereogs_register_exporters(register: Register[SpzExporter]) -> None:
    register("spz", SpzExporter)
