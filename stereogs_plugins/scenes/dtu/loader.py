"""`dtu`: scans of the DTU MVS data set (Jensen et al. 2014) in the sparse-view protocol.

View numbers are 0-based among the scan's 49 photographs: 25 is `000025.png` or `rect_026_3_r5000.png`.
Metrics count the pixels inside the object's mask, which is white on the object. Pixels that resizing turns
grey do not count, as in the published evaluations.
"""

from __future__ import annotations

import re
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, ClassVar, Literal

from pydantic import Field

from registry import Fact, Register, Scene, SceneError, SceneLoader, Settings, View, hookimpl
from registry.toolkit.images import dark_background
from registry.toolkit.photos import (
    Decoder,
    LoadedPhotos,
    PosedPhoto,
    ResizeFilter,
    at_most,
    estimate_bounds,
    list_images,
)

if TYPE_CHECKING:
    from .cameras import DtuCameras


TRAIN_VIEWS = (25, 22, 28, 40, 44, 48, 0, 8, 13)
"""Training views: the first three, six or nine (PixelNeRF, RegNeRF and later work)."""
_STANDARD_LIGHT = re.compile(r"rect_\d{3}_3_", re.ASCII)
TEST_VIEWS = (
    *(1, 2, 9, 10, 11, 12, 14, 15, 23, 24, 26, 27),
    *(29, 30, 31, 32, 33, 34, 35, 41, 42, 43, 45, 46, 47),
)
"""The 25 test views, for any number of training views; the other 15 are badly lit and unused."""


class DTUSettings(Settings):
    path: Path
    """Path of the scan's folder with image/, mask/ and cameras_sphere.npz or sparse/0."""
    train_views: Literal[3, 6, 9] = 3
    """Number of training views, in the order 25, 22, 28, 40, 44, 48, 0, 8, 13."""
    cameras: Literal["calibrated", "colmap"] = "calibrated"
    """`calibrated` reads cameras_sphere.npz, in units of the object's sphere; `colmap` reads the model
    in sparse/0, in its own units, and undistorts photographs."""
    width: int = Field(400, ge=1)
    """Wider photographs are resized to this width; 400 is the published quarter of 1600."""
    resize_filter: ResizeFilter = "bicubic"
    """Pillow filter for resizing."""
    masks: bool = True
    """Read object masks for the metrics; without them every pixel counts."""
    dark_background: int | None = Field(None, ge=1, le=255)
    """In training photographs, set pixels whose brightest channel is below this (of 255), and the 50 pixels
    to their left, to black; published values are 30, and 15 for scan 110. null changes nothing."""


class DTUScene(SceneLoader[DTUSettings]):
    """Loader of DTU scans: 49 photographs, calibrated cameras or a COLMAP model, object masks."""

    recognized_by: ClassVar[str] = "cameras_sphere.npz"

    @classmethod
    def recognizes(cls, folder: Path) -> bool:
        """Return True if the folder contains cameras_sphere.npz."""
        return (folder / "cameras_sphere.npz").is_file()

    def load(self) -> Scene:
        """Return the scene.

        Raises:
            SceneError: a missing or damaged file, a missing view, or a matrix that is not a camera.
        """
        settings = self.settings
        folder = settings.path.expanduser()
        train = list(TRAIN_VIEWS[: settings.train_views])
        found = self._read_cameras(folder, train)
        photos = self._photos(folder, found, [*train, *TEST_VIEWS])
        decoder = Decoder(at_most(settings.width), settings.resize_filter)
        loaded = LoadedPhotos.load(photos, decoder, train, list(TEST_VIEWS))
        loaded.require_one_size()
        bounds = found.bounds or estimate_bounds(loaded.training_cameras, found.points, str(folder))
        rule = f"the standard {settings.train_views} train, the standard 25 test"
        dark = settings.dark_background
        facts = (
            Fact("cameras", settings.cameras),
            *loaded.split_facts(rule, len(list_images(photos[0].path.parent))),
            Fact("masks", "metrics inside object masks" if settings.masks else "none"),
            Fact(
                "dark_background",
                f"training pixels below {dark} black" if dark else "kept",
                affects_scores=False,
            ),
        )
        scene = loaded.scene("dtu", folder, bounds, found.points, facts)
        return replace(scene, train=tuple(self._darkened(view) for view in scene.train))

    def _read_cameras(self, folder: Path, train: list[int]) -> DtuCameras:
        from .cameras import calibrated, from_colmap

        wanted = [*train, *TEST_VIEWS]
        if self.settings.cameras == "colmap":
            return from_colmap(folder / "sparse" / "0", train, wanted)
        return calibrated(folder / "cameras_sphere.npz", wanted)

    def _photos(self, folder: Path, found: DtuCameras, numbers: list[int]) -> list[PosedPhoto]:
        images = _by_view(folder, ("image", "images"), numbers, "")
        masks = {}
        if self.settings.masks:
            masks = _by_view(folder, ("mask",), numbers, ", or set `masks: false`")
        return [
            PosedPhoto(
                name=images[number].stem,
                path=images[number],
                world_to_camera=found.cameras[number].world_to_camera,
                lens=found.cameras[number].lens,
                where=f"{folder}, view {number}",
                mask=masks.get(number),
                white_mask=True,
            )
            for number in numbers
        ]

    def _darkened(self, view: View) -> View:
        level = self.settings.dark_background
        if level is None:
            return view
        background = dark_background(view.image, level)
        return replace(view, image=view.image.masked_fill(background[..., None], 0.0))


def _by_view(
    folder: Path, names: tuple[str, ...], numbers: list[int], hint: str
) -> dict[int, Path]:
    """Images by view number, from the first folder in `names` that has any."""
    from .cameras import view_number

    found: dict[int, Path] = {}
    for name in names:
        files = list_images(folder / name)
        # Scans as published by DTU have a photograph for each of seven lights, and one of their maximum.
        for path in [path for path in files if _STANDARD_LIGHT.match(path.stem)] or files:
            number = view_number(path.stem, str(path))
            if number in found:
                raise SceneError(
                    f"{found[number].name} and {path.name} are of the same view",
                    where=str(folder / name),
                    fix="keep one image of each view",
                )
            found[number] = path
        if found:
            break
    missing = [number for number in numbers if number not in found]
    if missing:
        raise SceneError(
            f"the images of the views {missing} are missing",
            where=" or ".join(str(folder / name) for name in names),
            fix=f"set `path` to the folder of one complete scan{hint}",
        )
    return found


@hookimpl
def stereogs_register_scenes(register: Register[DTUScene]) -> None:
    register("dtu", DTUScene)
