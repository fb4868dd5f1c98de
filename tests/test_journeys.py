"""Journeys of new users, in a shell, with real photographs: from the first command to the last line."""

from __future__ import annotations

import json
import os
import shutil
import subprocess
import sys
from collections.abc import Iterator, Sequence
from pathlib import Path

import pytest
from PIL import Image
from skimage import data

from tests.data import data_folder
from tests.host import main

ORIENTATION, EXIF_BLOCK, FOCAL_MM, FOCAL_35MM = 0x0112, 0x8769, 0x920A, 0xA405
SMALL = (320, 240)
ROOM = "--set scene='{use: procedural, train_views: 3, width: 96, height: 72}'"


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
    """JPEGs of some photographs of a scene, scaled into this size."""
    folder.mkdir(exist_ok=True)
    photographs = sorted(next(data_folder(scene).glob("images*")).iterdir())
    taken = []
    for number in numbers:
        with Image.open(photographs[number]) as opened:
            picture = opened.convert("RGB")
        scale = min(size[0] / picture.width, size[1] / picture.height)
        picture = picture.resize((round(picture.width * scale), round(picture.height * scale)))
        taken.append(folder / f"IMG_{number:04}.jpg")
        picture.save(taken[-1], quality=92)
    return taken


def tag(picture: Path, exif: bytes) -> None:
    with Image.open(picture) as opened:
        copy = opened.copy()
    copy.save(picture, quality=92, exif=exif)


@pytest.mark.proof
def test_a_folder_with_all_that_people_have_in_it(tmp_path: Path) -> None:
    """A text, a raw file, a broken picture, a copy and a stray picture beside four with absurd EXIF data."""
    folder = tmp_path / "my photos"
    first, second, third, fourth = take("llff_fern", (0, 4, 9, 14), folder, SMALL)
    absurd = Image.Exif()
    absurd[ORIENTATION] = 9
    absurd.get_ifd(EXIF_BLOCK)[FOCAL_MM] = absurd.get_ifd(EXIF_BLOCK)[FOCAL_35MM] = 0
    tag(second, absurd.tobytes())
    tag(third, absurd.tobytes()[:20])
    absurd.get_ifd(EXIF_BLOCK)[FOCAL_35MM] = 65535
    tag(fourth, absurd.tobytes())
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
    assert "PIL" not in output, "warnings of Pillow"
    *_, verdict, command = output.splitlines()
    assert verdict.startswith("4 of 5 photographs connect; ready")
    assert command == "  stereogs train 'my photos'"

    trained = shell(f"{command} --seconds 0.1 --out run", tmp_path)
    assert "scores are of training photographs; --test-every 8 holds out every 8th" in trained
    assert "late      took" in trained
    assert "30 iterations took" in trained, "the least"
    better = "for a better scene: stereogs train 'my photos' --quality fast"
    assert better in trained
    assert better.replace("'", "&#x27;") in (tmp_path / "run" / "report.html").read_text("utf-8")
    assert "PIL" not in trained
    assert "finding the cameras" not in trained, "they are cached"
    results = json.loads((tmp_path / "run" / "results.json").read_text())
    assert len(results["scene"]["train"]) == 4
    assert results["train"]["psnr"] > 18
    assert (tmp_path / "run" / "report.html").is_file()

    refused = shell("stereogs train 'my photos' --require-all-photos", tmp_path, status=2)
    assert "only 4 of 5 photographs connect" in refused
    assert "STEREOGS_MODELS" in refused
    assert not (tmp_path / "runs").exists()


@pytest.fixture
def disk(tmp_path: Path) -> Iterator[Path]:
    """A file system of 1 MB."""
    folder = tmp_path / "disk"
    folder.mkdir()
    mounted = ["mount", "-t", "tmpfs", "-o", "size=1m", "tmpfs", str(folder)]
    if sys.platform != "linux" or subprocess.run(mounted, capture_output=True).returncode:
        pytest.skip("only root can mount a file system")
    yield folder
    subprocess.run(["umount", "--lazy", str(folder)], check=True)  # this process may use it


def test_a_full_disk_loses_nothing(disk: Path, capsys: pytest.CaptureFixture[str]) -> None:
    room = "{use: procedural, train_views: 3, width: 96, height: 72}"
    short = ["--set", f"scene={room}", "--set", "training.iterations=40"]
    assert main(["train", "demo", *short, "--out", str(disk / "run")]) == 2
    output = capsys.readouterr().err
    assert "No space left on device" in output
    assert f"stereogs resume {disk / 'run'}" in output
    subprocess.run(["mount", "-o", "remount,size=99m", str(disk)], check=True)
    assert main(["resume", str(disk / "run")]) == 0
    assert "hash " in capsys.readouterr().out


def test_a_read_only_folder_is_refused_before_the_work(
    disk: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    photographs = [str(take("llff_fern", (0, 4, 9), tmp_path / "photos", SMALL)[0].parent)]
    subprocess.run(["mount", "-o", "remount,ro", str(disk)], check=True)
    monkeypatch.chdir(disk)
    for command in ("check", "train"):
        assert main([command, *photographs]) == 2
        output = "".join(capsys.readouterr())
        assert f"the folder {disk} cannot be written" in output
        assert "choose another --out" in output
        assert "reading" not in output
    assert main(["check", *photographs, "--out", str(tmp_path)]) == 0
    assert (tmp_path / "check.png").is_file()


@pytest.mark.proof
@pytest.mark.parametrize(
    ("scene", "numbers"), [("llff_fern", (0, 4, 9)), ("llff_flower", (0, 12, 24))]
)
def test_three_photographs_train_on_three(
    scene: str, numbers: tuple[int, ...], tmp_path: Path
) -> None:
    take(scene, numbers, tmp_path / "photos", (504, 378))
    output = shell("stereogs train photos --quality fast --out run", tmp_path)
    assert "--test-every 8 holds out every 8th" in output
    assert "3 training views, 0 test views" in output
    results = json.loads((tmp_path / "run" / "results.json").read_text())
    assert results["train"]["psnr"] > 24
    held_out = shell("stereogs train photos --quality fast --test-every 3 --out scored", tmp_path)
    assert "2 training views, 1 test view," in held_out
    assert "finding the cameras" not in held_out
    assert "test mean" in held_out


@pytest.mark.proof
def test_pictures_of_a_phone(tmp_path: Path) -> None:
    """Twelve megapixels, one stored sideways."""
    *_, last = take("llff_fern", (0, 4, 9), tmp_path / "DCIM", (4032, 3024))
    exif = Image.Exif()
    exif[ORIENTATION] = 6
    with Image.open(last) as opened:
        sideways = opened.transpose(Image.Transpose.ROTATE_90)
    sideways.save(last, quality=92, exif=exif)
    output = shell("stereogs check DCIM --details", tmp_path)
    assert "3 of 3 photographs connect; ready" in output
    assert "turned upright         1" in output


@pytest.mark.proof
def test_a_turntable_with_gaps(tmp_path: Path) -> None:
    """What does not connect is one short warning, and the rest a scene."""
    take("mview_temple", range(0, 29, 3), tmp_path / "temple", (640, 480))
    output = shell("stereogs check temple", tmp_path)
    warning = output[output.index("WARNING: ") :].partition("more: ")[0].splitlines()
    assert len(warning) <= 6
    assert "take pictures between" in output
    assert "STEREOGS_MODELS" in output
    assert " of 10 photographs connect; ready" in output.splitlines()[-2]
    assert output.splitlines()[-1] == "  stereogs train temple"


@pytest.mark.proof
def test_lengths_are_compared(tmp_path: Path) -> None:
    for length in (50, 200):
        shell(
            f"stereogs train demo {ROOM} --set training.iterations={length} --out runs/{length}",
            tmp_path,
        )
    rows = [line.split() for line in shell("stereogs compare runs/*", tmp_path).splitlines()]
    assert [row[1:3] for row in rows if row and row[0] in ("50", "200")] == [
        ["200", "iterations"],
        ["50", "iterations"],
    ]
    (tmp_path / "matrix.yaml").write_text(
        "pipelines: [3dgs_fast, weightfree_quick]\niterations: [20]\n"
        "scenes: [{use: procedural, train_views: 3, width: 96, height: 72}]\n"
    )
    shell("stereogs bench matrix.yaml --out bench --jobs 1", tmp_path)
    page = (tmp_path / "bench" / "index.html").read_text()
    assert "against seconds" in page
    assert "against pipeline" not in page


@pytest.mark.proof
def test_ctrl_c_and_resume_give_the_scene_of_an_undisturbed_run(tmp_path: Path) -> None:
    train = f"stereogs train demo {ROOM} --set training.iterations=300 --out"
    # With job control, background jobs do not ignore SIGINT.
    output = shell(
        f"set -m; {train} stopped & until [ -s stopped/metrics.jsonl ]; do sleep 0.1; done; "
        "kill -INT %1; wait %1",
        tmp_path,
        status=130,
    )
    assert "stereogs resume stopped" in output
    assert not (tmp_path / "stopped" / "results.json").exists()
    shell("stereogs resume stopped", tmp_path)
    shell(f"{train} undisturbed", tmp_path)
    hashes = [
        json.loads((tmp_path / run / "results.json").read_text())["hash"]
        for run in ("stopped", "undisturbed")
    ]
    assert hashes[0] == hashes[1]


@pytest.mark.proof
def test_seconds_on_a_busy_machine_end_in_a_scene(tmp_path: Path) -> None:
    take("llff_fern", (0, 4, 9), tmp_path / "photos", (504, 378))
    busy = [subprocess.Popen([sys.executable, "-c", "while True: pass"]) for _ in range(2)]
    try:
        output = shell("stereogs train photos --seconds 10 --out run", tmp_path)
    finally:
        for process in busy:
            process.kill()
            process.wait()
    assert "trained: weightfree_quick" in output
    results = json.loads((tmp_path / "run" / "results.json").read_text())
    assert len(results["scene"]["train"]) == 3
    assert results["train"]["psnr"] > 15
    assert (tmp_path / "run" / "report.html").is_file()


@pytest.mark.proof
def test_an_own_pipeline_is_written_trained_ablated_and_exported(tmp_path: Path) -> None:
    assert "next: stereogs train mine.yaml" in shell("stereogs init mine", tmp_path)
    again = shell("stereogs init mine", tmp_path, status=2)
    assert "mine.yaml" in again
    pipeline = tmp_path / "mine.yaml"
    text = pipeline.read_text()
    pipeline.write_text(text.replace("gradient_threshold", "gradient_treshold"))
    misspelt = shell("stereogs train mine.yaml", tmp_path, status=2)
    assert "mine.yaml:" in misspelt
    assert "gradient_threshold" in misspelt
    pipeline.write_text(text)

    short = f"{ROOM} --set training.iterations=40"
    output = shell(f"stereogs train mine.yaml {short} --out run", tmp_path)
    assert "0:00 left" not in output
    results = json.loads((tmp_path / "run" / "results.json").read_text())
    assert results["train"]["psnr"] > 12

    ablation = f"stereogs ablate mine.yaml --toggle densification {short} --jobs 1 --out parts"
    assert "densification" in shell(ablation, tmp_path)
    rows = (tmp_path / "parts" / "ablation.csv").read_text().splitlines()
    assert len(rows) >= 3, "a heading, on and off"
    assert (tmp_path / "parts" / "index.html").is_file()

    if shutil.which("splat-transform"):
        shell("stereogs export run --format sog", tmp_path)
        assert (tmp_path / "run" / "exports" / "scene.sog").is_file()
    else:
        refused = shell("stereogs export run --format sog", tmp_path, status=2)
        (command,) = [line for line in refused.splitlines() if "npx @playcanvas" in line]
        assert command.endswith("scene.ply run/exports/scene.sog")
        assert (tmp_path / "run" / "exports" / "scene.ply").is_file()
