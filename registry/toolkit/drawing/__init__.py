"""Pictures and videos of renders, depths and camera paths."""

from typing import TYPE_CHECKING

from core_rasterizer.first_use import names_on_first_use

if TYPE_CHECKING:
    from .camera_path import smooth_path
    from .logged_pictures import LoggerSettings
    from .metric_images import ImageMetricSettings, white_outside
    from .orientation import upright_rotation
    from .pictures import (
        RAMP,
        ViewPictures,
        depth_ends,
        grey,
        nearness_picture,
        ramp_picture,
        save_png,
        side_by_side,
    )
    from .video import write_video
else:
    __getattr__, __dir__ = names_on_first_use(__name__)

__all__ = [
    "RAMP",
    "ImageMetricSettings",
    "LoggerSettings",
    "ViewPictures",
    "depth_ends",
    "grey",
    "nearness_picture",
    "ramp_picture",
    "save_png",
    "side_by_side",
    "smooth_path",
    "upright_rotation",
    "white_outside",
    "write_video",
]
