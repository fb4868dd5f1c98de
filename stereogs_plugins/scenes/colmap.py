"""`colmap`: a COLMAP model, binary or text, with its photographs, for example Mip-NeRF 360 as published."""

from __future__ import annotations

from pathlib import Path
from typing import ClassVar

from pydantic import Field

from registry import Register, Scene, SceneLoader, hookimpl
from registry.toolkit.photos import (
    ColmapModel,
    ImageSourceSettings,
    LoadedPhotos,
    PosedPhoto,
    SplitSettings,
    estimate_bounds,
    has_colmap_model,
    inside,
    read_colmap_model,
    view_names,
)

_FIX = "set `path` to a folder with images and a complete COLMAP model (see `model`)"


class ColmapSettings(SplitSettings, ImageSourceSettings):
    path: Path
    """Path of the scene's folder with the photographs and the model."""
    model: str = "sparse/0"
    """Folder of the model within the scene's: cameras, images and points3D as .bin or .txt."""
    downsample: int = Field(1, ge=1)
    """Factor by which each side of the full-size photographs is reduced for training."""
    max_size: int | None = Field(1600, ge=16)
    """Longer side of the photographs, at most, in pixels; larger ones are resized. 1600 as in 3DGS;
    null: no limit."""
    points: bool = True
    """Use those points of the model that the training views see."""


class ColmapScene(SceneLoader[ColmapSettings]):
    """Loader of COLMAP models. Photographs are undistorted; principal points stay off-centre."""

    recognized_by: ClassVar[str] = "sparse/0 with a COLMAP model"

    @classmethod
    def recognizes(cls, folder: Path) -> bool:
        """Return True if the folder contains a COLMAP model in sparse/0."""
        return has_colmap_model(folder / "sparse" / "0")

    def load(self) -> Scene:
        """Return the scene.

        Raises:
            SceneError: a missing, truncated or inconsistent file, an unknown camera model, or a photograph
                that is missing or differs in shape from its camera.
        """
        settings = self.settings
        folder = settings.path.expanduser()
        model = read_colmap_model(inside(folder, settings.model, "the setting `model`"), _FIX)
        train, test, rule = settings.split(len(model.images), str(folder))
        all_photos = _photos(model, settings.image_folder(folder))
        photos = [all_photos[index] for index in train + test]
        loaded = LoadedPhotos.load(photos, settings.decoder(), train, test)
        points = None
        if settings.points:
            tracks = model.tracks()
            tracks.check(len(model.images), str(model.folder))
            points = tracks.seen_by(train)
        bounds = estimate_bounds(loaded.training_cameras, points, str(folder))
        facts = loaded.split_facts(rule, len(model.images))
        return loaded.scene("colmap", folder, bounds, points, facts)


def _photos(model: ColmapModel, images: Path) -> list[PosedPhoto]:
    places = [f"{model.folder}, image {image.name!r}" for _, image in model.images]
    names = view_names([image.name for _, image in model.images])
    return [
        PosedPhoto(
            name=name,
            path=inside(images, image.name, where),
            world_to_camera=image.world_to_camera,
            lens=model.lens(image),
            where=where,
        )
        for (_, image), name, where in zip(model.images, names, places, strict=True)
    ]


@hookimpl
def stereogs_register_scenes(register: Register[ColmapScene]) -> None:
    register("colmap", ColmapScene)
