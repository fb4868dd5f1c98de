"""`nerfstudio`: a capture in nerfstudio's format, `transforms.json` (Tancik et al. 2023)."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, ClassVar

from pydantic import Field

from registry import Fact, PointCloud, Register, Scene, SceneError, SceneLoader, hookimpl
from registry.toolkit.photos import (
    Decoder,
    LoadedPhotos,
    PosedPhoto,
    ResizeFilter,
    SplitSettings,
    divided_by,
    estimate_bounds,
    evenly_spaced,
    inside,
    pose_from_opengl,
    split,
    split_rule,
    view_names,
)

from .transforms import Transforms, lens_of, read_transforms

if TYPE_CHECKING:
    pass


class NerfstudioSettings(SplitSettings):
    path: Path
    """The scene's folder; it holds transforms.json."""
    downsample: int = Field(1, ge=1)
    """Photographs are reduced this much on each side."""
    resize_filter: ResizeFilter = "bicubic"
    """Pillow's filter for that."""
    points: bool = False
    """Take the points of `ply_file_path`. The file does not tell which photographs saw a point, so
    points of test views come along; not for numbers that are compared with others."""


class NerfstudioScene(SceneLoader[NerfstudioSettings]):
    """Reads `transforms.json`. Distorted photographs are undistorted; the world stays the file's."""

    recognized_by: ClassVar[str] = "transforms.json"

    @classmethod
    def recognizes(cls, folder: Path) -> bool:
        """Whether the folder holds transforms.json."""
        return (folder / "transforms.json").is_file()

    def load(self) -> Scene:
        """Return the scene; split as the file says, or like LLFF if it does not.

        Raises:
            SceneError: a missing or damaged file, a field that is missing or not finite, a photograph
                that is missing or has another shape than its camera.
        """
        settings = self.settings
        folder = settings.path.expanduser()
        path = folder / "transforms.json"
        transforms = read_transforms(path)
        all_photos = _photos(folder, path, transforms)
        train, test, rule = self._split(transforms, str(path))
        photos = [all_photos[index] for index in train + test]
        decoder = Decoder(divided_by(settings.downsample), settings.resize_filter)
        loaded = LoadedPhotos.load(photos, decoder, train, test)
        points = _read_points(folder, transforms, path) if settings.points else None
        bounds = estimate_bounds(loaded.training_cameras, points, str(path))
        seen_by = Fact("points_seen_by", "all photographs" if points else "none")
        facts = (*loaded.split_facts(rule, len(all_photos)), seen_by)
        return loaded.scene("nerfstudio", folder, bounds, points, facts)

    def _split(self, transforms: Transforms, where: str) -> tuple[list[int], list[int], str]:
        """Indices into the frames, sorted by file name, and the rule behind them."""
        settings = self.settings
        names = sorted(frame.file_path for frame in transforms.frames)
        if transforms.train_filenames is None or transforms.test_filenames is None:
            train, test = split(len(names), settings.test_every, settings.train_views, where)
            return train, test, split_rule(settings.test_every)
        index = {name: k for k, name in enumerate(names)}
        listed = [*transforms.train_filenames, *transforms.test_filenames]
        unknown = [name for name in listed if name not in index]
        pool = [index[name] for name in transforms.train_filenames if name in index]
        if unknown or (settings.train_views or 1) > len(pool):
            raise SceneError(
                f"the split names {unknown[0]!r}, which is no frame"
                if unknown
                else f"{settings.train_views or 1} training views are wanted, the file lists {len(pool)}",
                where=where,
                fix="correct train_filenames and test_filenames, or lower `train_views`",
            )
        train = evenly_spaced(sorted(pool), settings.train_views)
        return (
            train,
            [index[name] for name in transforms.test_filenames],
            "the file's, evenly spaced",
        )


def _photos(folder: Path, path: Path, transforms: Transforms) -> list[PosedPhoto]:
    """The photographs of all frames, sorted by file name."""
    frames = sorted(enumerate(transforms.frames), key=lambda item: item[1].file_path)
    names = view_names([frame.file_path for _, frame in frames])
    photos = []
    for (index, frame), name in zip(frames, names, strict=True):
        where = f"{path}, frame {index}"
        photos.append(
            PosedPhoto(
                name=name,
                path=inside(folder, frame.file_path, where),
                world_to_camera=pose_from_opengl(frame.transform_matrix, where),
                lens=lens_of(frame, transforms, where),
                where=where,
                mask=inside(folder, frame.mask_path, where) if frame.mask_path else None,
            )
        )
    return photos


def _read_points(folder: Path, transforms: Transforms, path: Path) -> PointCloud | None:
    from core_rasterizer import load_points

    if transforms.ply_file_path is None:
        return None
    file = inside(folder, transforms.ply_file_path, str(path))
    positions, colors = load_points(file)
    return PointCloud(positions=positions, colors=colors) if len(positions) else None


@hookimpl
def stereogs_register_scenes(register: Register[NerfstudioScene]) -> None:
    register("nerfstudio", NerfstudioScene)
