"""Pictures and videos of renders, depths and camera paths."""

from typing import TYPE_CHECKING

from core_rasterizer.first_use import names_on_first_use

if TYPE_CHECKING:
    from .camera_path import smooth_path
    from .logged_pictures import LoggerSettings
    from .metric_images import ImageMetricSettings, white_outside
    from .orientation import Vector, upright_rotation, upwards
    from .pictures import (
        COMPARISONS,
        RAMP,
        ViewPictures,
        depth_ends,
        depth_picture,
        grey,
        nearness_picture,
        ramp_picture,
        save_png,
        save_view_pictures,
        side_by_side,
        to_bytes,
    )
    from .video import write_video
else:
    __getattr__, __dir__ = names_on_first_use(__name__)

__all__ = [
    "COMPARISONS",
    "RAMP",
    "ImageMetricSettings",
    "LoggerSettings",
    "Vector",
    "ViewPictures",
    "depth_ends",
    "depth_picture",
    "grey",
    "nearness_picture",
    "ramp_picture",
    "save_png",
    "save_view_pictures",
    "side_by_side",
    "smooth_path",
    "to_bytes",
    "upright_rotation",
    "upwards",
    "white_outside",
    "write_video",
]
