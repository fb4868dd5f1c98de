"""The 3D view of Gaussians, embedded in a page or in files next to it."""

from __future__ import annotations

import base64
import gzip
import json
import math
from dataclasses import dataclass, replace
from html import escape
from importlib.resources import files
from itertools import count
from typing import TYPE_CHECKING, Any

import numpy as np

from registry.toolkit import spz_bytes, web_page, write_text
from registry.toolkit.drawing import CAMERA_LIMITS, upwards

from .reach import reaches

if TYPE_CHECKING:
    from collections.abc import Mapping
    from pathlib import Path

    from numpy.typing import NDArray

    from core_rasterizer import Camera, Gaussians
    from registry import Scene

BESIDE = "report_files"
"""Folder of the files next to the page."""
_VIEWER_FILE, _DATA_FILE = "viewer.js", "scene.js"
_VIEWER = files(__package__) / "viewer"
_NEAR_ALL = 90.0
"""Per cent of the Gaussians within the viewer's cube of width 10, along each axis."""
_RADIUS = 5.0
_MIN_SHOWN = 0.45
"""Share of a photograph's width and height in view, at least, so that a portrait fills a wide window.
Objects on a plain background are shown whole."""
MAX_SUGGESTED = 3
"""Suggested cameras that the menu offers."""
_HELP = (
    "Drag to turn, pinch or click and scroll to zoom, two fingers or Shift to move. The camera stays within "
    "{angle:g}° of the photographs and {nearest:g} to {farthest:g} times their distance to the subject."
).format(**CAMERA_LIMITS)


@dataclass(frozen=True)
class SceneView:
    """The 3D part of a page.

    Args:
        content: HTML.
        files: files written next to the page.
    """

    content: str
    files: tuple[Path, ...] = ()


@dataclass(frozen=True)
class PackedScene:
    """A scene as the viewer reads it.

    Args:
        splats: the Gaussians, SPZ.
        setup: the argument `setup` of `showScene` in viewer/scene_view.js.
        names: names of the poses in `setup["views"]`, by kind and in their order.
        aspect: width and height of the first photograph.
    """

    splats: bytes
    setup: dict[str, Any]
    names: dict[str, list[str]]
    aspect: tuple[int, int]


def pack(
    gaussians: Gaussians,
    scene: Scene,
    dilation: float,
    compensate_dilation: bool,
    suggested: Mapping[str, Camera] = {},
) -> PackedScene:
    """Return a scene for the viewer: the training views, the test views, and cameras that are suggested.

    Args:
        gaussians: at least one.
        dilation, compensate_dilation: as the Gaussians were trained, see `GaussianModel`.
        suggested: cameras for the next pictures by where they are, best first.
    """
    center, factor = _frame(gaussians)
    best = list(suggested)[:MAX_SUGGESTED]
    cameras = [view.camera for view in (*scene.train, *scene.test)]
    cameras += [suggested[place] for place in best]
    distances = reaches(gaussians, cameras)
    setup = {
        "up": upwards([view.camera for view in scene.train]).tolist(),
        "background": list(scene.background),
        "dilation": dilation,
        "compensate": compensate_dilation,
        "shown": 1.0 if all(view.alpha is not None for view in scene.train) else _MIN_SHOWN,
        "limits": CAMERA_LIMITS,
        "views": [
            _pose(camera, center, factor)
            | {"reach": distance * factor, "train": k < len(scene.train)}
            for k, (camera, distance) in enumerate(zip(cameras, distances, strict=True))
        ],
    }
    names = {
        "Trained on": [view.name for view in scene.train],
        "Held out": [view.name for view in scene.test],
        "Take next": best,
    }
    aspect = cameras[0].width, cameras[0].height
    return PackedScene(spz_bytes(_framed(gaussians, center, factor)), setup, names, aspect)


def view_inside(packed: PackedScene) -> SceneView:
    """Return a view with everything that it needs."""
    viewer = gzip.compress(_read("viewer.js").encode(), 4, mtime=0)
    data = _embedded("viewer-data", viewer) + _embedded("scene-data", packed.splats)
    return SceneView(_view(packed, data))


def view_beside(packed: PackedScene, folder: Path) -> SceneView:
    """Return a view for a page in `folder`, with the viewer and the Gaussians in files next to it."""
    place = folder / BESIDE
    place.mkdir(exist_ok=True)
    viewer, data = place / _VIEWER_FILE, place / _DATA_FILE
    # A local page may load scripts, but no other files.
    write_text(viewer, _read("viewer.js"))
    write_text(data, f'globalThis["scene-data"]="{_base64(packed.splats)}";\n')
    scripts = "".join(f'<script src="{BESIDE}/{file.name}"></script>' for file in (viewer, data))
    return SceneView(_view(packed, scripts), (viewer, data))


def licenses() -> str:
    """Return the licences of the viewer, folded."""
    return web_page.folded("Licences of the 3D viewer", web_page.verbatim(_read("LICENSES.txt")))


def style() -> str:
    """Return the style of the view, which a page holds once."""
    return f"<style>\n{_read('view.css')}</style>"


def remove_beside(folder: Path) -> None:
    """Remove the files that an earlier report wrote next to its page, and no others.

    Args:
        folder: the run folder.
    """
    beside = folder / BESIDE
    for name in (_VIEWER_FILE, _DATA_FILE):
        (beside / name).unlink(missing_ok=True)
    if beside.is_dir() and not any(beside.iterdir()):
        beside.rmdir()


def _view(packed: PackedScene, data: str) -> str:
    width, height = packed.aspect
    setup = json.dumps(packed.setup).replace("<", "\\u003c")
    return (
        f'{style()}<div class="scene-view"><div class="frame">'
        f'<div class="canvas" style="aspect-ratio:{width}/{height}">'
        "<p>The 3D view needs JavaScript.</p></div>"
        f'<div class="buttons" hidden>{_BUTTONS}<select aria-label="Seen by">{_options(packed)}'
        f"</select></div></div>{web_page.note(_HELP)}</div>"
        f'<script type="application/json" id="scene-setup">{setup}</script>'
        f"{data}<script>{_read('start.js')}</script>"
    )


_BUTTONS = (
    '<button class="back" hidden>Back to the photographs</button>'
    '<button class="play">Pause</button><button class="whole">Full screen</button>'
)


def _options(packed: PackedScene) -> str:
    """Return menu items: one for no view, then all views, by kind."""
    items, index = '<option value="">Seen by …</option>', count()
    for kind, names in packed.names.items():
        own = "".join(f'<option value="{next(index)}">{escape(name)}</option>' for name in names)
        items += f'<optgroup label="{kind}">{own}</optgroup>' if own else ""
    return items


def _frame(gaussians: Gaussians) -> tuple[NDArray[np.float64], float]:
    """Return the scene's centre and scale factor for the viewer: SPZ is most precise at sizes near 1."""
    means = gaussians.means.double().numpy()
    center = np.median(means, axis=0)
    radius = float(np.percentile(np.abs(means - center), _NEAR_ALL))
    return center, _RADIUS / max(radius, 1e-9)


def _framed(gaussians: Gaussians, center: NDArray[np.float64], factor: float) -> Gaussians:
    import torch

    return replace(
        gaussians,
        means=(gaussians.means.double() - torch.from_numpy(center)) * factor,
        log_scales=gaussians.log_scales + math.log(factor),
    )


def _pose(camera: Camera, center: NDArray[np.float64], factor: float) -> dict[str, Any]:
    # OpenGL cameras look along -z with y up, OpenCV cameras along z with y down.
    pose = camera.camera_to_world.numpy() @ np.diag([1.0, -1.0, -1.0, 1.0])
    pose[:3, 3] = (pose[:3, 3] - center) * factor
    fov = math.degrees(2 * math.atan(camera.height / (2 * camera.fy)))
    return {"pose": pose.flatten().tolist(), "fov": fov, "aspect": camera.width / camera.height}


def _embedded(name: str, data: bytes) -> str:
    return f'<script type="text/plain" id="{name}">{_base64(data)}</script>'


def _base64(data: bytes) -> str:
    return base64.b64encode(data).decode("ascii")


def _read(name: str) -> str:
    return (_VIEWER / name).read_text("utf-8")
