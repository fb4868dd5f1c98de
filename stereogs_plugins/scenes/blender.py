"""`blender`: the synthetic scenes of NeRF (Mildenhall et al. 2020), with `transforms_train.json`.

The number of a photograph is at the end of its file name: 26 for `./train/r_26`. Names of views include the
split because both splits have an r_0.
"""

from __future__ import annotations

import logging
import math
import re
from pathlib import Path
from typing import Annotated, ClassVar, Literal

import pydantic
from pydantic import Field

from registry import Fact, Register, Scene, SceneError, SceneLoader, Settings, hookimpl
from registry.toolkit.photos import (
    BACKGROUNDS,
    Decoder,
    Finite,
    Lens,
    LoadedPhotos,
    PosedPhoto,
    PoseMatrix,
    ResizeFilter,
    at_most,
    find_image,
    inside,
    object_bounds,
    pose_from_opengl,
    read_document,
    stored_size,
)

STANDARD_VIEWS = (2, 16, 26, 55, 73, 76, 86, 93)
"""The eight training views of sparse-view Gaussian splatting; DietNeRF's list has 75 for 76."""
_FIX = "use the files of a NeRF synthetic scene: camera_angle_x, and frames with a 4x4 matrix each"
_NO_TEST_FIX = f"{_FIX}; without test views set `test_every: 0`"
_log = logging.getLogger("stereogs.photos")
_JOIN = "join both files as transforms.json, which the loader nerfstudio reads"


class BlenderSettings(Settings):
    path: Path
    """Path of the scene's folder with transforms_train.json and transforms_test.json."""
    train_ids: tuple[int, ...] | Literal["standard"] | None = "standard"
    """Numbers of the training photographs. `standard` takes r_2, r_16, r_26, r_55, r_73, r_76, r_86 and
    r_93, or all if one of these does not exist; null takes all."""
    test_every: int = Field(8, ge=0)
    """Test views are the photographs of transforms_test.json with a number divisible by this; 0 gives no
    test views."""
    background: Literal["white", "black"] = "white"
    """Colour behind transparent pixels, and the scene's background; part of the protocol."""
    width: int = Field(400, ge=1)
    """Wider photographs are resized to this width; 400 is the published half of 800."""
    resize_filter: ResizeFilter = "bicubic"
    """Pillow filter for resizing."""
    near: float | None = Field(None, gt=0)
    """Near depth bound; null: half the distance to the point that the cameras look at. 2 and 6 are the
    published bounds of NeRF's scenes, whose cameras are 4 units away."""
    far: float | None = Field(None, gt=0)
    """Far depth bound; null: 1.5 times that distance."""


class BlenderScene(SceneLoader[BlenderSettings]):
    """Loader of NeRF's synthetic scenes: transparent renders with exact cameras."""

    recognized_by: ClassVar[str] = "transforms_train.json"

    @classmethod
    def recognizes(cls, folder: Path) -> bool:
        """Return True if the folder contains transforms_train.json."""
        return (folder / "transforms_train.json").is_file()

    def load(self) -> Scene:
        """Return the scene.

        Raises:
            SceneError: a missing or damaged file, a missing photograph, or an invalid pose.
        """
        settings = self.settings
        folder = settings.path.expanduser()
        train = _read_split(folder, "train")
        every = settings.test_every
        test = _read_split(folder, "test", _NO_TEST_FIX) if every else {}
        train_ids = self._train_ids(train)
        test_ids = [number for number in test if every and number % every == 0]
        if test and not test_ids:
            _log.warning(
                "there are no test views: transforms_test.json has no number divisible by `test_every`, "
                "which is %d; `test_every: 1` tests all",
                every,
            )
        missing = [number for number in train_ids if number not in train]
        if missing:
            raise SceneError(
                f"the training photographs {missing} are missing",
                where=str(folder / "transforms_train.json"),
                fix="set `train_ids` to numbers of existing photographs, or to null for all",
            )
        if len({*train_ids}) < len(train_ids):
            raise SceneError(
                "a number in `train_ids` is repeated",
                where=str(folder),
                fix="list each number once",
            )
        photos = [train[k] for k in train_ids] + [test[k] for k in test_ids]
        decoder = Decoder(
            at_most(settings.width), settings.resize_filter, BACKGROUNDS[settings.background]
        )
        loaded = LoadedPhotos.load(photos, decoder, train_ids, test_ids)
        loaded.require_one_size()
        facts = (
            Fact("transparent_pixels", f"laid on {settings.background}"),
            *loaded.split_facts(
                f"given numbers train, {f'every {every}th' if every else 'none'} tests",
                len(train) + len(test),
            ),
        )
        near, far = object_bounds(loaded.training_cameras, str(folder))
        bounds = (settings.near or near, settings.far or far)
        return loaded.scene("blender", folder, bounds, None, facts)

    def _train_ids(self, train: dict[int, PosedPhoto]) -> list[int]:
        chosen = self.settings.train_ids
        if chosen == "standard":
            published = all(k in train and train[k].path.stem == f"r_{k}" for k in STANDARD_VIEWS)
            if published:
                return [*STANDARD_VIEWS]
            _log.info("not a scene of NeRF's data set: all %d photographs train", len(train))
            return [*train]
        return [*(train if chosen is None else chosen)]


class _Frame(pydantic.BaseModel, extra="allow"):
    file_path: str
    transform_matrix: PoseMatrix


class _Transforms(pydantic.BaseModel):
    camera_angle_x: Annotated[Finite, Field(gt=0, lt=math.pi)] | None = None
    fl_x: Finite | None = None
    fl_y: Finite | None = None
    cx: Finite | None = None
    cy: Finite | None = None
    w: Finite | None = None
    h: Finite | None = None
    is_fisheye: bool = False
    k1: Finite = 0.0
    k2: Finite = 0.0
    k3: Finite = 0.0
    k4: Finite = 0.0
    p1: Finite = 0.0
    p2: Finite = 0.0
    frames: tuple[_Frame, ...]

    def lens(self, image: Path, where: str) -> Lens:
        """Return the lens; without further fields it has square pixels and a centred principal point.

        Raises:
            SceneError: the fields describe a distorted lens, or no focal length.
        """
        if self.is_fisheye or any((self.k1, self.k2, self.k3, self.k4, self.p1, self.p2)):
            raise SceneError(
                "the lens is distorted, which renders are not",
                where=where,
                fix=_JOIN,
            )
        stored = stored_size(image)
        width = stored[0] if self.w is None else self.w
        height = stored[1] if self.h is None else self.h
        focal = self.fl_x
        if focal is None:
            if self.camera_angle_x is None:
                raise SceneError("the field 'camera_angle_x' is missing", where=where, fix=_FIX)
            focal = width / 2 / math.tan(self.camera_angle_x / 2)
        return Lens(
            fx=focal,
            fy=focal if self.fl_y is None else self.fl_y,
            cx=width / 2 if self.cx is None else self.cx,
            cy=height / 2 if self.cy is None else self.cy,
            width=width,
            height=height,
        )


def _read_split(folder: Path, split: str, fix: str = _FIX) -> dict[int, PosedPhoto]:
    """Photographs of one split by number, in the order of the file."""
    path = folder / f"transforms_{split}.json"
    content = read_document(path, _Transforms, fix)
    photos: dict[int, PosedPhoto] = {}
    lens = None
    for index, frame in enumerate(content.frames):
        where = f"{path}, frame {index}"
        image = inside(folder, frame.file_path, where)
        number = re.search(r"(\d+)$", image.stem, re.ASCII)
        if number is None or int(number[1]) in photos:
            raise SceneError(
                f"the file name {frame.file_path!r} does not end in a unique number",
                where=where,
                fix="name photographs like r_0, r_1, ...",
            )
        for field, value in (frame.model_extra or {}).items():
            if field in _Transforms.model_fields and value != getattr(content, field):
                what = f"the frame has its own {field!r}, but all share one lens in this format"
                raise SceneError(what, where=where, fix=_JOIN)
        lens = lens or content.lens(find_image(image, fix), str(path))
        photos[int(number[1])] = PosedPhoto(
            name=f"{split}_{image.stem}",
            path=image,
            world_to_camera=pose_from_opengl(frame.transform_matrix, where),
            lens=lens,
            where=where,
        )
    return photos


@hookimpl
def stereogs_register_scenes(register: Register[BlenderScene]) -> None:
    register("blender", BlenderScene)
