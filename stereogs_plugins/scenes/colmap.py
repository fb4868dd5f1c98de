"""`colmap`: a COLMAP model, binary or text, with its photographs, for example Mip-NeRF 360 as published."""

from __future__ import annotations

import logging
from pathlib import Path
from typing import ClassVar

from pydantic import Field

from registry import Register, Scene, SceneError, SceneLoader, hookimpl
from registry.toolkit.photos import (
    ColmapModel,
    ImageSourceSettings,
    LoadedPhotos,
    PosedPhoto,
    SplitSettings,
    colmap_models,
    count_images,
    decoding,
    estimate_bounds,
    inside,
    masks_beside,
    read_colmap_model,
    usable_photos,
    view_names,
)

_FIX = "write the model again, with its three files, or set `path` and `model` to a complete one"
_MISSING_FIX = "restore them, or set `images` to the folder in which the model's names begin"
_log = logging.getLogger("stereogs.photos")


class ColmapSettings(SplitSettings, ImageSourceSettings):
    path: Path
    """Path of the scene's folder with the photographs and the model."""
    model: str | None = None
    """Folder of the model within the scene's: cameras, images and points3D as .bin or .txt. null finds it in
    sparse, colmap/sparse, dense/sparse, the folder itself or others; of several, the one with most images."""
    downsample: int = Field(1, ge=1)
    """Factor by which each side of the full-size photographs is reduced for training."""
    max_size: int | None = Field(1600, ge=16)
    """Longer side of the photographs, at most, in pixels; larger ones are resized. 1600 as in 3DGS;
    null: no limit."""
    points: bool = True
    """Use those points of the model that the training views see."""
    masks: bool = True
    """Exclude pixels where a mask is black from training and scores. The mask of images_2/a.jpg is a.jpg.png
    or a.png in masks_2 or masks."""


class ColmapScene(SceneLoader[ColmapSettings]):
    """Loader of COLMAP models. Photographs are undistorted; principal points stay off-centre.

    A file `test.txt` beside the model, as the exporter `colmap` writes it, lists the test views, unless
    `test_every` is given.
    """

    recognized_by: ClassVar[str] = "a COLMAP model, for example in sparse/0"

    @classmethod
    def recognizes(cls, folder: Path) -> bool:
        """Return True if the folder contains a COLMAP model that is not one of nerfstudio's files."""
        others = (folder / "transforms.json").is_file()
        models = colmap_models(folder, anywhere=not others)
        return any(not (others and model.is_relative_to(folder / "colmap")) for model in models)

    def load(self) -> Scene:
        """Return the scene.

        Raises:
            SceneError: a missing, truncated or inconsistent file, an unknown camera model, a photograph that
                differs in shape from its camera, or more than half of the photographs missing.
        """
        settings = self.settings
        folder = settings.path.expanduser()
        model = read_colmap_model(self._model_folder(folder), _FIX)
        images = self._image_folder(folder, model.folder)
        all_photos = _photos(model, images, settings.masks)
        kept = usable_photos(all_photos, str(model.folder), _MISSING_FIX)
        names = [model.images[index][1].name for index in kept]
        train, test, rule = self._split(names, model.folder)
        train, test = [kept[k] for k in train], [kept[k] for k in test]
        photos = [all_photos[index] for index in train + test]
        loaded = LoadedPhotos.load(photos, settings.decoder(), train, test)
        loaded.report_transparency()
        points = None
        if settings.points:
            tracks = model.tracks()
            tracks.check(len(model.images), str(model.folder))
            points = tracks.seen_by(train)
        bounds = estimate_bounds(loaded.training_cameras, points, str(folder))
        facts = loaded.split_facts(rule, len(all_photos))
        return loaded.scene("colmap", folder, bounds, points, facts)

    def _model_folder(self, folder: Path) -> Path:
        """Return the folder of the model; of several, the one with most images, with a warning.

        Raises:
            SceneError: the folder holds several scenes.
        """
        if self.settings.model is not None:
            return inside(folder, self.settings.model, "the setting `model`")
        models = colmap_models(folder)
        if not models:
            return folder / "sparse" / "0"
        scenes = {self._holder(folder, model) for model in models}
        if len(scenes) > 1 and not colmap_models(folder, anywhere=False):
            names = ", ".join(sorted(str(scene.relative_to(folder)) for scene in scenes))
            raise SceneError(
                f"the folder holds several scenes: {names}",
                where=str(folder),
                fix="give the folder of one of them, or set `model`",
            )
        counts = {model: count_images(model) for model in models}
        chosen = max(models, key=lambda model: counts[model])
        if others := [model for model in models if model != chosen and counts[model]]:
            listed = ", ".join(f"{m.relative_to(folder)} ({counts[m]})" for m in others)
            _log.warning(
                "the model with most images is used: %s (%d); the others are not: %s. --set "
                "scene.model=FOLDER chooses another",
                *(chosen.relative_to(folder), counts[chosen], listed),
            )
        return chosen

    def _image_folder(self, folder: Path, model: Path) -> Path:
        """Return the folder of the photographs, in the scene's folder or beside the model, as in dense/0."""
        return self.settings.image_folder(self._holder(folder, model))

    def _holder(self, folder: Path, model: Path) -> Path:
        """Return the folder with a model's folders of photographs; the scene's if none has any."""
        places = [folder, *(place for place in model.parents if place.is_relative_to(folder))]
        holders = [place for place in places if any(place.glob("images*/"))]
        return [*holders, folder][0]

    def _split(self, names: list[str], model: Path) -> tuple[list[int], list[int], str]:
        """Return the indices of training and test views among the sorted names, and the rule."""
        listed = model / "test.txt"
        if self.settings.test_every is not None or not listed.is_file():
            return self.settings.split(len(names), str(model))
        fix = "write a name of the model in each line, or ignore the file with `test_every`"
        with decoding("the list of test views", listed, fix):
            tested = {*filter(None, map(str.strip, listed.read_text("utf-8-sig").splitlines()))}
        test = [k for k, name in enumerate(names) if name in tested]
        if tested and not test:
            what = "the list of test views names no image of the model"
            raise SceneError(what, where=str(listed), fix=fix)
        if unknown := sorted(tested.difference(names)):
            _log.warning(
                "%s lists %d photographs that are missing, for example %s",
                *(listed, len(unknown), unknown[0]),
            )
        pool = [k for k in range(len(names)) if k not in test]
        return self.settings.chosen(pool, str(listed)), test, "the file's, evenly spaced"


def _photos(model: ColmapModel, images: Path, with_masks: bool) -> list[PosedPhoto]:
    places = [f"{model.folder}, image {image.name!r}" for _, image in model.images]
    files = [image.name.replace("\\", "/") for _, image in model.images]
    names = view_names(files)
    prefix = f"{images.name}/"
    if all(file.startswith(prefix) for file in files) and not (images / prefix).is_dir():
        files = [file.removeprefix(prefix) for file in files]  # relative to the scene's folder
    paths = [inside(images, file, where) for file, where in zip(files, places, strict=True)]
    masks = masks_beside(images, paths) if with_masks else [None] * len(paths)
    return [
        PosedPhoto(
            name=name,
            path=path,
            world_to_camera=image.world_to_camera,
            lens=model.lens(image),
            where=where,
            mask=mask,
            mask_trains=True,
        )
        for (_, image), name, path, where, mask in zip(
            model.images, names, paths, places, masks, strict=True
        )
    ]


@hookimpl
def stereogs_register_scenes(register: Register[ColmapScene]) -> None:
    register("colmap", ColmapScene)
