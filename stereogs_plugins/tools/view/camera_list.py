"""cameras.json, the list of cameras that the 3DGS code and many tools leave beside a PLY file."""

from __future__ import annotations

import logging
from pathlib import Path
from typing import Annotated

import numpy as np
import torch
from pydantic import BaseModel, Field, RootModel

from core_rasterizer import Camera, ExplainedError
from registry.toolkit.photos import Finite, read_document

FILE = "cameras.json"
_Vector = tuple[Finite, Finite, Finite]
_Pixels = Annotated[int, Field(gt=0, le=65_535)]
_FocalLength = Annotated[float, Field(gt=0, allow_inf_nan=False)]

_log = logging.getLogger(__name__)


class _Listed(BaseModel):
    """A camera as the 3DGS code writes it: the columns of `rotation` are its axes in the world."""

    img_name: str
    width: _Pixels
    height: _Pixels
    position: _Vector
    rotation: tuple[_Vector, _Vector, _Vector]
    fx: _FocalLength
    fy: _FocalLength

    def camera(self) -> Camera:
        """With the principal point in the middle: the format has none."""
        pose = np.eye(4)
        pose[:3, :3], pose[:3, 3] = self.rotation, self.position
        middle = self.width / 2, self.height / 2
        world_to_camera = torch.from_numpy(np.linalg.inv(pose))
        return Camera(world_to_camera, self.fx, self.fy, *middle, self.width, self.height)


_CameraList = RootModel[list[_Listed]]


def cameras_beside(ply: Path) -> list[tuple[str, Camera]]:
    """Names and cameras that `cameras.json` lists beside a PLY file; none where there is no such file.

    One that cannot be read is warned of: the Gaussians can be looked at without it.
    """
    file = ply.with_name(FILE)
    if not file.is_file():
        return []
    try:
        listed = read_document(file, _CameraList, "write it anew, or take it away").root
        return [(one.img_name, one.camera()) for one in listed]
    except (ExplainedError, np.linalg.LinAlgError) as error:
        what = error.what if isinstance(error, ExplainedError) else str(error)
        _log.warning("the cameras are not shown: %s (%s)", what, file)
        return []
