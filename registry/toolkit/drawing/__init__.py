"""Images and videos of renders, depth maps and camera paths; shared settings of metrics and loggers.

from registry.toolkit.drawing import nearness_picture, save_png, smooth_path, write_video

save_png(nearness_picture(1 / depth, depth > 0), folder / "depth.png")
path = smooth_path([view.camera for view in scene.train], frames=120)
write_video((render(camera) for camera in path), folder / "flight")
"""

from typing import TYPE_CHECKING

from core_rasterizer.first_use import names_on_first_use

if TYPE_CHECKING:
    from .camera_path import (
        CAMERA_LIMITS as CAMERA_LIMITS,
        quarter_turns as quarter_turns,
        smooth_path as smooth_path,
        turned as turned,
        upright_rotation as upright_rotation,
        upwards as upwards,
    )
    from .pictures import (
        DRAWN as DRAWN,
        RAMP as RAMP,
        ViewPictures as ViewPictures,
        depth_ends as depth_ends,
        nearness_picture as nearness_picture,
        ramp_picture as ramp_picture,
        save_png as save_png,
        side_by_side as side_by_side,
        to_bytes as to_bytes,
    )
    from .video import write_video as write_video
else:
    __all__, __dir__, __getattr__ = names_on_first_use(__name__)
