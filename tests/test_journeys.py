"""Journeys of new users, in a shell, with real photographs: from the first command to the last line."""

from __future__ import annotations

import json
import os
import subprocess
import sys
from collections.abc import Sequence
from pathlib import Path

from PIL import Image
from skimage import data

from tests.data import data_folder

ORIENTATION = 0x0112
SMALL = (320, 240)


def shell(command: str, folder: Path, *, status: int = 0) -> str:
    """Output and messages of a command that ends with this status."""
    environment = os.environ | {
        "STEREOGS_CACHE": str(folder / "cache"),
        "PATH": f"{Path(sys.executable).parent}{os.pathsep}{os.environ['PATH']}",
    }
    environment.pop("STEREOGS_MODELS", None)
    done = subprocess.run(
        ["bash", "-c", command],
        cwd=folder,
        env=environment,
        stdin=subprocess.DEVNULL,
        stdout=subprocess.PIPE,
        stderr=subprocess.STDOUT,
        text=True,
        check=False,
    )
    assert done.returncode == status, done.stdout
    return done.stdout


def take(scene: str, numbers: Sequence[int], folder: Path, size: tuple[int, int]) -> list[Path]:
    """JPEGs of some photographs of a scene, at most of this size."""
    folder.mkdir(exist_ok=True)
    photographs = sorted((data_folder(scene) / "images_8").iterdir())
    taken = []
    for number in numbers:
        with Image.open(photographs[number]) as opened:
            picture = opened.convert("RGB")
        scale = min(size[0] / picture.width, size[1] / picture.height)
        picture = picture.resize((round(picture.width * scale), round(picture.height * scale)))
        taken.append(folder / f"IMG_{number:04}.jpg")
        picture.save(taken[-1], quality=92)
    return taken


def test_a_folder_with_all_that_people_have_in_it(tmp_path: Path) -> None:
    """A text, a raw file, a broken picture, a copy and a stray picture beside four that connect."""
    folder = tmp_path / "my photos"
    first, *_ = take("llff_fern", (0, 4, 9, 14), folder, SMALL)
    (folder / "notes.txt").write_text("shopping list")
    (folder / "IMG_0020.dng").write_bytes(b"II*\0 raw")
    (folder / "broken.jpg").write_bytes(first.read_bytes()[:2000])
    (folder / "copy of IMG_0000.jpg").write_bytes(first.read_bytes())
    Image.fromarray(data.coffee()).resize(SMALL).save(folder / "stray.jpg")

    output = shell("stereogs check 'my photos'", tmp_path)
    for line in (
        "broken.jpg: the photograph cannot be read",
        "IMG_0020.dng: unsupported format; convert it to JPEG or PNG",
        "copy of IMG_0000.jpg: a copy of IMG_0000.jpg",
        "WARNING: 4 of 5 photographs connect",
        "stray.jpg: ",
        "notes.txt: not a picture",
    ):
        assert line in output
    assert output.count("stray.jpg: ") == 1
    *_, verdict, command = output.splitlines()
    assert verdict.startswith("4 of 5 photographs connect; ready")
    assert command == "  stereogs train 'my photos'"

    trained = shell(f"{command} --set training.iterations=20 --out run", tmp_path)
    assert "4 photographs, fewer than 8: all train" in trained
    assert "finding the cameras" not in trained, "they are cached"
    results = json.loads((tmp_path / "run" / "results.json").read_text())
    assert len(results["scene"]["train"]) == 4
    assert results["train"]["psnr"] > 18
    assert (tmp_path / "run" / "report.html").is_file()

    refused = shell("stereogs train 'my photos' --require-all-photos", tmp_path, status=2)
    assert "only 4 of 5 photographs connect" in refused
    assert "STEREOGS_MODELS" in refused
    assert not (tmp_path / "runs").exists()
