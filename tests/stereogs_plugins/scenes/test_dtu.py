from __future__ import annotations

import os
import shutil
import signal
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from registry import Scene, SceneError
from stereogs_plugins.scenes.dtu import DTUScene, stereogs_register_scenes
from stereogs_plugins.scenes.dtu.cameras import view_number
from tests.data import data_folder
from tests.stereogs_plugins.building import build, offered
from tests.stereogs_plugins.scenes.small_scenes import (
    DTU_VIEWS,
    POINTS,
    World,
    assert_sees_the_points,
    write_colmap,
    write_dtu,
)

WORLD = World(count=DTU_VIEWS, width=64, height=48)


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    return write_dtu(tmp_path / "scan", WORLD)


def load(folder: Path, **settings: object) -> Scene:
    return build(DTUScene, path=folder, **settings).load()


def test_registers_as_dtu() -> None:
    assert offered(stereogs_register_scenes) == {"dtu": DTUScene}


@pytest.mark.parametrize("count", [3, 6, 9])
def test_the_standard_views(count: int, folder: Path) -> None:
    scene = load(folder, train_views=count)
    expected = [25, 22, 28, 40, 44, 48, 0, 8, 13][:count]
    assert [int(view.name) for view in scene.train] == expected
    tests = {int(view.name) for view in scene.test}
    assert len(tests) == 25
    assert not tests & {
        25,
        22,
        28,
        40,
        44,
        48,
        0,
        8,
        13,
        3,
        4,
        5,
        6,
        7,
        *range(16, 22),
        36,
        37,
        38,
        39,
    }


def test_poses_are_in_units_of_the_sphere(folder: Path) -> None:
    scene = load(folder)
    for view in (*scene.train, *scene.test):
        np.testing.assert_allclose(
            view.camera.world_to_camera.numpy(), WORLD.pose(int(view.name)), atol=1e-9
        )
    assert scene.bounds == pytest.approx((425 / 200, 935 / 200))


def test_only_pure_white_of_a_mask_counts(folder: Path) -> None:
    for view in load(folder).test:
        assert view.mask is not None
        assert not view.mask[:, :17].any()
        assert view.mask[:, 17:].all()
        assert view.weights is None  # evaluation only
    assert all(view.mask is None for view in load(folder, masks=False).test)


def test_a_larger_mask_is_reduced_with_the_photograph(folder: Path) -> None:
    view = load(folder, width=32).test[0]
    assert view.image.shape == (24, 32, 3)
    assert view.mask is not None
    assert view.mask.shape == (24, 32)
    assert view.mask[:, 12:].all()
    assert not view.mask[:, :8].any()


def test_dark_background_becomes_black_in_training_views_alone(folder: Path) -> None:
    scene = load(folder, dark_background=70)  # the grey of the photographs is 60
    assert scene.train[0].image[0, 0].tolist() == [0, 0, 0]
    assert scene.test[0].image[0, 0].tolist() == pytest.approx([60 / 255] * 3)
    assert "70" in str(scene.fact("dark_background"))


def test_cameras_of_a_colmap_model(tmp_path: Path) -> None:
    folder = write_colmap(tmp_path, WORLD, model="PINHOLE")
    model = folder / "sparse" / "0" / "images.bin"
    content = model.read_bytes()
    for index in range(DTU_VIEWS):
        old, new = f"IMG_{index:02d}.JPG", f"rect_{index + 1:03d}_3_r5000.png"
        (folder / "images" / f"IMG_{index:02d}.png").rename(folder / "images" / new)
        content = content.replace(old.encode(), new.encode())
    model.write_bytes(content)
    scene = load(folder, cameras="colmap", masks=False)
    assert [view.name for view in scene.train] == [f"rect_{k:03d}_3_r5000" for k in (26, 23, 29)]
    assert_sees_the_points(scene)
    assert scene.points is not None
    assert len(scene.points) == len(POINTS)


def edit(name: str, change: Callable[[np.ndarray], np.ndarray]) -> Callable[[Path], None]:
    def damage(folder: Path) -> None:
        path = folder / "cameras_sphere.npz"
        arrays = dict(np.load(path))
        arrays[name] = change(arrays[name])
        np.savez(path, **arrays)

    return damage


def set_entry(row: int, column: int, value: float) -> Callable[[np.ndarray], np.ndarray]:
    def change(array: np.ndarray) -> np.ndarray:
        array[row, column] = value
        return array

    return change


def one_size_differs(folder: Path) -> None:
    Image.new("RGB", (32, 24)).save(folder / "image" / "000001.png")


DAMAGES: dict[str, tuple[Callable[[Path], object], str]] = {
    "no cameras": (lambda f: (f / "cameras_sphere.npz").unlink(), "camera file is missing"),
    "no archive": (lambda f: (f / "cameras_sphere.npz").write_bytes(b"PK"), "cannot be read"),
    "nan": (edit("world_mat_25", set_entry(0, 0, np.nan)), "not finite"),
    "shape": (edit("world_mat_25", lambda m: m[:3]), "not 4x4"),
    "singular": (edit("world_mat_25", lambda m: 0 * m), "not the matrix of a camera"),
    "mirrored": (
        edit("world_mat_25", lambda m: m * np.array([[-1], [1], [1], [1]])),
        "mirrored",
    ),
    "scale differs": (edit("scale_mat_1", lambda m: 2 * m), "differs"),
    "scale bent": (edit("scale_mat_25", set_entry(0, 1, 5.0)), "differs"),
    "no image": (
        lambda f: (f / "image" / "000022.png").unlink(),
        "the images of the views [22] are missing",
    ),
    "no mask": (
        lambda f: (f / "mask" / "022.png").unlink(),
        "the images of the views [22] are missing",
    ),
    "black mask": (
        lambda f: Image.new("L", (64, 48)).save(f / "mask" / "022.png"),
        "mask leaves no pixel",
    ),
    "bad mask": (lambda f: (f / "mask" / "022.png").write_bytes(b""), "mask cannot be read"),
    "odd name": (
        lambda f: (f / "image" / "000022.png").rename(f / "image" / "x.png"),
        "does not contain a view number",
    ),
    "one size": (one_size_differs, "the image is 32x24, the others are 64x48"),
}


@pytest.mark.parametrize(("damage", "message"), DAMAGES.values(), ids=list(DAMAGES))
def test_bad_input_is_an_error(
    damage: Callable[[Path], object], message: str, folder: Path
) -> None:
    damage(folder)
    with pytest.raises(SceneError) as caught:
        load(folder)
    assert message in caught.value.what
    assert caught.value.where
    assert caught.value.fix


def test_view_numbers() -> None:
    assert view_number("000025", "") == 25
    assert view_number("rect_026_3_r5000", "") == 25


def test_cameras_are_the_same_bits_with_the_linear_algebra_of_another_processor(
    folder: Path,
) -> None:
    """OpenBLAS treats this processor as a Haswell; only one with AVX-512 has other kernels to compare."""
    script = (
        "import sys, pathlib; from stereogs_plugins.scenes.dtu.cameras import calibrated\n"
        "found = calibrated(pathlib.Path(sys.argv[1]), list(map(int, sys.argv[2:])))\n"
        "print([(c.world_to_camera.tobytes().hex(), c.lens) for c in found.cameras.values()])"
    )
    command = [
        sys.executable,
        "-c",
        script,
        str(folder / "cameras_sphere.npz"),
        *map(str, range(DTU_VIEWS)),
    ]
    said = [
        subprocess.run(command, env=os.environ | env, capture_output=True, text=True, check=False)
        for env in ({}, {"OPENBLAS_CORETYPE": "HASWELL"})
    ]
    if said[1].returncode == -signal.SIGILL:
        pytest.skip("this processor has no AVX2")
    assert [run.returncode for run in said] == [0, 0], said[1].stderr
    assert said[0].stdout == said[1].stdout


@pytest.mark.parametrize("name", ["dtu_scan24", "dtu_scan65"])
def test_real_masks_and_cameras_agree(name: str) -> None:
    scene = load(data_folder(name), train_views=9)
    assert (len(scene.train), len(scene.test)) == (9, 25)
    for view in (*scene.train, *scene.test):
        camera = view.camera
        assert (camera.width, camera.height) == (400, 300)
        assert camera.fx == pytest.approx(723.08, abs=0.01)
        # The readme of the data gives the principal point for pixel centres at whole numbers.
        assert camera.cx - 0.5 == pytest.approx(205.43, abs=0.01)
        depth = float(camera.world_to_camera[2, 3])  # of the sphere's centre
        assert depth > 1  # the unit sphere lies in front
        assert scene.bounds[0] < depth < scene.bounds[1]
        assert view.mask is not None
        x, y = camera.world_to_camera[:2, 3] / depth
        column, row = int(camera.fx * x + camera.cx), int(camera.fy * y + camera.cy)
        assert view.mask[row, column]  # the sphere's centre lies on the object


def test_the_standard_light_is_used(folder: Path) -> None:
    images = folder / "image"
    for number in range(DTU_VIEWS):
        published = f"rect_{number + 1:03d}"
        (images / f"{number:06d}.png").rename(images / f"{published}_3_r5000.png")
        for other in ("0_r5000", "max"):
            (images / f"{published}_{other}.png").write_bytes(b"")
    assert all(view.name.endswith("_3_r5000") for view in load(folder).train)


def test_two_images_of_a_view_are_refused(folder: Path) -> None:
    shutil.copy(folder / "image" / "000003.png", folder / "image" / "3.png")
    with pytest.raises(SceneError, match="of the same view"):
        load(folder)
