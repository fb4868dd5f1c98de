"""`turntable`: photographs from a turntable with one lens; a scene loader built on registry.toolkit.photos.

The folder contains the photographs and turntable.json:

    {"focal": 900.0, "size": [800, 600], "distortion": [0, 0, 0, 0],
     "shots": [{"file": "000.png", "camera_to_world": [[...], [...], [...], [...]]}, ...]}

`focal` and `size` are in pixels, `distortion` is k1, k2, p1, p2 of COLMAP's OPENCV model, poses are 4x4
with OpenGL's axes: x right, y up, z backwards.
"""

from pathlib import Path
from typing import ClassVar

import pydantic

from registry.toolkit import photos
from stereogs import api

STEREOGS_API = 1
"""Version of the plugin API that this module was written for."""


class Shot(pydantic.BaseModel):
    file: str
    camera_to_world: photos.PoseMatrix


class Turntable(pydantic.BaseModel):
    focal: photos.Finite
    size: tuple[int, int]
    distortion: tuple[photos.Finite, photos.Finite, photos.Finite, photos.Finite]
    shots: tuple[Shot, ...]


class TurntableSettings(photos.SplitSettings):
    path: Path
    """Folder with turntable.json and the photographs."""
    max_size: int = pydantic.Field(800, ge=16)
    """Maximum length of the longer side in pixels; larger photographs are reduced."""


class TurntableScene(api.SceneLoader[TurntableSettings]):
    """Scene from turntable.json: one lens, OpenGL poses, split like LLFF."""

    recognized_by: ClassVar[str] = "turntable.json"

    @classmethod
    def recognizes(cls, folder: Path) -> bool:
        return (folder / "turntable.json").is_file()

    def load(self) -> api.Scene:
        settings, path = self.settings, self.settings.path / "turntable.json"
        table = photos.read_document(path, Turntable, "write turntable.json again")
        shots = [self._photo(table, index, str(path)) for index in range(len(table.shots))]
        train, test, rule = settings.split(len(shots), str(path))
        decoder = photos.Decoder(photos.longest_side(settings.max_size))
        loaded = photos.LoadedPhotos.load([shots[k] for k in train + test], decoder, train, test)
        bounds = photos.estimate_bounds(loaded.training_cameras, None, str(path))
        facts = loaded.split_facts(rule)
        return loaded.scene("turntable", settings.path, bounds, None, facts)

    def _photo(self, table: Turntable, index: int, path: str) -> photos.PosedPhoto:
        shot, where, (width, height) = table.shots[index], f"{path}, shot {index}", table.size
        return photos.PosedPhoto(
            name=Path(shot.file).stem,
            path=photos.inside(self.settings.path, shot.file, where),
            world_to_camera=photos.pose_from_opengl(shot.camera_to_world, where),
            lens=photos.Lens(
                table.focal,
                table.focal,
                width / 2,
                height / 2,
                width,
                height,
                model="OPENCV",
                distortion=table.distortion,
            ),
            where=where,
        )


@api.hookimpl
def stereogs_register_scenes(register: api.Register[TurntableScene]) -> None:
    register("turntable", TurntableScene)
