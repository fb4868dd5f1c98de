"""Images and videos of renders, depth maps and camera paths; shared settings of metrics and loggers.

from registry.toolkit.drawing import nearness_picture, save_png, smooth_path, write_video

save_png(nearness_picture(1 / depth, depth > 0), folder / "depth.png")
path = smooth_path([view.camera for view in scene.train], frames=120)
write_video((render(camera) for camera in path), folder / "flight")
"""

from typing import TYPE_CHECKING

from core_rasterizer.first_use import names_on_first_use

if TYPE_CHECKING:
    from .camera_path import Vector, smooth_path, upright_rotation, upwards
    from .confidence_picture import CONFIDENCE, GUESSED, hatched, read_confidence, with_scale
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
    from .settings import ImageMetricSettings, LoggerSettings, row_bands, white_outside
    from .video import write_video
else:
    __getattr__, __dir__ = names_on_first_use(__name__)

__all__ = [
    "COMPARISONS",
    "CONFIDENCE",
    "GUESSED",
    "RAMP",
    "ImageMetricSettings",
    "LoggerSettings",
    "Vector",
    "ViewPictures",
    "depth_ends",
    "depth_picture",
    "grey",
    "hatched",
    "nearness_picture",
    "ramp_picture",
    "read_confidence",
    "row_bands",
    "save_png",
    "save_view_pictures",
    "side_by_side",
    "smooth_path",
    "to_bytes",
    "upright_rotation",
    "upwards",
    "white_outside",
    "with_scale",
    "write_video",
]
