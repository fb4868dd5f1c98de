"""The 3D view of the run's Gaussians, embedded in the page or in files next to it."""

from __future__ import annotations

import base64
import gzip
import json
import math
from dataclasses import dataclass, replace
from html import escape
from importlib.resources import files
from typing import TYPE_CHECKING, Any

import numpy as np

from registry.system import write_text
from registry.toolkit import web_page

from .spz import spz

if TYPE_CHECKING:
    from collections.abc import Sequence
    from pathlib import Path

    from numpy.typing import NDArray

    from core_rasterizer import Gaussians
    from registry import Scene, View

BESIDE = "report_files"
"""Folder of the files next to the page."""
_VIEWER_FILE, _DATA_FILE = "viewer.js", "scene.js"
_VIEWER = files(__package__) / "viewer"
_NEAR_ALL = 90.0
"""Per cent of the Gaussians within the viewer's cube of width 10, along each axis."""
_RADIUS = 5.0
_LICENSES = "Licences of the 3D viewer (Spark, three.js, fflate)"


@dataclass(frozen=True)
class SceneView:
    """The 3D part of the page.

    Args:
        content: HTML.
        files: files written next to the page.
    """

    content: str
    files: tuple[Path, ...] = ()


def scene_view(
    gaussians: Gaussians,
    scene: Scene,
    training: dict[str, Any],
    folder: Path,
    *,
    beside: bool,
    largest_mb: float,
) -> SceneView:
    """Return an interactive 3D view that starts at the first test view.

    Args:
        gaussians: at least one.
        training: the pipeline's training settings: `dilation` and `compensate_dilation` are used.
        folder: the run folder, for files next to the page.
        beside: write the viewer and the Gaussians to files next to the page instead of embedding them.
        largest_mb: largest embedded scene; a larger one is replaced by a note.
    """
    center, factor = _frame(gaussians)
    packed = spz(_framed(gaussians, center, factor))
    megabytes = len(packed) / 1e6
    if not beside and megabytes > largest_mb:
        text = (
            f"The Gaussians take {megabytes:.0f} MB; at most {largest_mb:g} MB are embedded. "
            f"`stereogs report {folder.name} --beside` writes them to files next to the page."
        )
        return SceneView(web_page.note(text))
    setup = _setup(scene, training, center, factor)
    written: tuple[Path, ...] = ()
    if beside:
        written = _write_beside(folder / BESIDE, packed)
        data = "".join(f'<script src="{BESIDE}/{file.name}"></script>' for file in written)
    else:
        data = _embedded("viewer-data", gzip.compress(_read("viewer.js").encode(), 4, mtime=0))
        data += _embedded("scene-data", packed)
    names = [f"{kind} {view.name}" for kind, view in _views(scene)]
    shape = f"{scene.train[0].camera.width} / {scene.train[0].camera.height}"
    return SceneView(
        '<div class="scene-view">'
        f'<div class="canvas" style="aspect-ratio:{shape};width:calc(80vh * {shape})">'
        "The 3D view needs JavaScript.</div>"
        f"<label>as seen by <select disabled>{''.join(map(_option, names))}</select></label> "
        + web_page.note("Drag to rotate, scroll or pinch to zoom, drag with two fingers to pan.")
        + "</div>"
        + f'<script type="application/json" id="scene-setup">{_json(setup)}</script>'
        + f"{data}<script>{_read('start.js')}</script>"
        + web_page.folded(_LICENSES, web_page.verbatim(_read("LICENSES.txt"))),
        written,
    )


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


def _setup(
    scene: Scene, training: dict[str, Any], center: NDArray[np.float64], factor: float
) -> dict[str, Any]:
    """Return the argument `setup` of `showScene` in viewer/scene_view.js."""
    rotations = [view.camera.world_to_camera.numpy()[:3, :3] for view in scene.train]
    return {
        "up": [-float(value) for value in np.mean(rotations, axis=0)[1]],
        "target": [0.0, 0.0, 0.0],
        "background": list(scene.background),
        "dilation": training.get("dilation", 0.3),
        "compensate": training.get("compensate_dilation", False),
        "views": [_pose(view, center, factor) for _, view in _views(scene)],
    }


def _views(scene: Scene) -> Sequence[tuple[str, View]]:
    return [("test", view) for view in scene.test] + [("train", view) for view in scene.train]


def _pose(view: View, center: NDArray[np.float64], factor: float) -> dict[str, Any]:
    camera = view.camera
    # OpenGL cameras look along -z with y up, OpenCV cameras along z with y down.
    pose = camera.camera_to_world.numpy() @ np.diag([1.0, -1.0, -1.0, 1.0])
    pose[:3, 3] = (pose[:3, 3] - center) * factor
    fov = math.degrees(2 * math.atan(camera.height / (2 * camera.fy)))
    return {"pose": pose.flatten().tolist(), "fov": fov}


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


def _write_beside(folder: Path, packed: bytes) -> tuple[Path, ...]:
    """Write scripts, the only files that a local page may load."""
    folder.mkdir(exist_ok=True)
    viewer, data = folder / _VIEWER_FILE, folder / _DATA_FILE
    write_text(viewer, _read("viewer.js"))
    write_text(data, f'globalThis["scene-data"]="{_base64(packed)}";\n')
    return viewer, data


def _embedded(name: str, data: bytes) -> str:
    return f'<script type="text/plain" id="{name}">{_base64(data)}</script>'


def _option(name: str) -> str:
    return f"<option>{escape(name)}</option>"


def _json(value: Any) -> str:
    return json.dumps(value).replace("<", "\\u003c")


def _base64(data: bytes) -> str:
    return base64.b64encode(data).decode("ascii")


def _read(name: str) -> str:
    return (_VIEWER / name).read_text("utf-8")
