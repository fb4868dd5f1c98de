"""PLY files: Gaussian scenes in binary, point clouds as text."""

from __future__ import annotations

import torch

from core_rasterizer import Gaussians, PlyError, load_ply, load_points, save_ply
from tests.fuzzing.target import Target

CLOUD = """\
ply
format ascii 1.0
comment three points and a face
element vertex 3
property float x
property float y
property float z
property uchar red
property uchar green
property uchar blue
element face 1
property list uchar int vertex_indices
end_header
0 0.5 1 255 0 0
1 -1.5 2 0 128 0
2 2.5 3e-1 0 0 1
3 0 1 2
"""


class PointFiles(Target):
    """An accepted file has finite numbers, colors in [0, 1], and the original number of rows."""

    name = "ply"

    def write(self) -> tuple[str, ...]:
        """Write four Gaussians of SH degree 1, and three points."""
        count = 4
        positions = torch.arange(3.0 * count).reshape(count, 3)
        gaussians = Gaussians.from_points(
            positions, torch.full((count, 3), 0.5), torch.ones(count), torch.full((count,), 0.5), 1
        )
        save_ply(gaussians, self.folder / "gaussians")
        (self.folder / "cloud.ply").write_text(CLOUD)
        return ("gaussians", "cloud.ply")

    def accepts(self, file: str, content: bytes) -> bool:
        """Read the damaged file only."""
        (self.folder / file).write_bytes(content)
        try:
            self._gaussians() if file == "gaussians" else self._cloud()
        except PlyError:
            return False
        finally:
            self.restore(file)
        return True

    def read(self) -> None:
        """Read both files."""
        self._gaussians()
        self._cloud()

    def _gaussians(self) -> None:
        found = load_ply(self.folder / "gaussians")
        for values in (found.means, found.log_scales, found.quaternions, found.sh):
            assert torch.isfinite(values).all()
        assert torch.isfinite(found.opacity_logits).all()

    def _cloud(self) -> None:
        positions, colors = load_points(self.folder / "cloud.ply")
        assert positions.shape == colors.shape
        assert torch.isfinite(positions).all()
        assert ((colors >= 0) & (colors <= 1)).all()
