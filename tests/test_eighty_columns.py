"""What a newcomer types wrongly, and is told, in a terminal of 80 columns."""

from __future__ import annotations

import shutil
import sys
from pathlib import Path

import pytest

import stereogs
from tests.host import main, verbs

WIDTH = 80
PIPELINE = """\
name: tiny
scene: {use: procedural, width: 32, height: 24, points: 300, test_views: 1}
initializer: sfm
regularizers: [{use: gaussian_shape, weight: 0.1}]
metrics: [psnr, ssim]
training: {iterations: 3, sh_degree: 0}
"""
RIGHT = (
    [],
    *(
        ["--help"],
        ["models"],
        ["plugins"],
        ["plugins", "consistency_dense"],
        ["explain", "tiny.yaml"],
    ),
    *([verb, "--help"] for verb in verbs()),
    ["eval", "run"],
    ["compare", "run", "run"],
    ["compare", "weightfree_fast-llff_flower", "run"],
    ["check", "tiny.yaml"],
)
WRONG = (
    *(["trian", "photos"], ["train"], ["train", "nowhere"], ["train", "3dsg"], ["train", "empty"]),
    ["train", "weightfree_fast", "--set", "scene.path=nowhere"],
    ["train", "weightfree_fast", "--set", "scene.use=lllff", "--set", "scene.path=photos"],
    ["train", "weightfree_fast", "--set", "scene.path=photos", "--set", "metrics=[psnr, lipps]"],
    ["train", "tiny.yaml", "--set", "training.iteration=30", "--set", "scene.widht=7"],
    ["train", "tiny.yaml", "--set", "regularizers.gaussian_shape.wieght=3"],
    ["train", "tiny.yaml", "--disable", "dropuot"],
    ["train", "tiny.yaml", "--out", "run"],
    ["train", "tiny.yaml", "--device", "no such device"],
    ["train", "photos", "--out", "new"],
    *(["check", "nowhere"], ["check", "empty"], ["check", "run"]),
    *(["resume", "nowhere"], ["eval", "empty"], ["render", "nowhere"], ["report", "nowhere"]),
    *(["replay", "nowhere"], ["compare", "nowhere", "run"], ["bench", "nowhere.yaml"]),
    *(["ablate", "nowhere"], ["explain", "nowhere"], ["plugins", "dropuot"]),
    *(["eval"], ["export", "run"], ["train", "photos", "--qualty", "best"], ["plugins", "new"]),
    *(["train", "photos", "--seconds", "soon"], ["completion", "bsh"], ["train", "--quality=bset"]),
    *(["export", "run", "--format", "gtlf"], ["view", "run"], ["train", "tiny.yaml", "--view"]),
    *(["priors", "check", "nowhere.onnx"], ["models", "get", "lpps"], ["models", "get", "hitnet"]),
)
MISSING = ("viser", "imageio")
"""Packages of extras that this newcomer has not installed."""


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    made = tmp_path_factory.mktemp("newcomer")
    (made / "tiny.yaml").write_text(PIPELINE)
    (made / "empty").mkdir()
    (made / "photos").mkdir()
    for name in ("IMG_0001.JPG", "IMG_0002.JPG", "IMG_0003.JPG"):
        (made / "photos" / name).write_bytes(b"not a picture")
    stereogs.train(PIPELINE, out=made / "run", progress=False)
    shutil.copytree(made / "run", made / "weightfree_fast-llff_flower")
    return made


@pytest.fixture
def newcomer(folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(folder)
    monkeypatch.setenv("COLUMNS", str(WIDTH))
    monkeypatch.delenv("STEREOGS_DATA", raising=False)
    monkeypatch.delenv("STEREOGS_MODELS", raising=False)
    for name in MISSING:
        monkeypatch.setitem(sys.modules, name, None)


def too_wide(text: str) -> list[str]:
    """Lines that could have been broken between two words and were not."""
    return [line for line in text.splitlines() if len(line) > WIDTH and " " in line.strip()]


def typed(arguments: list[str]) -> int:
    try:
        return main(arguments)
    except SystemExit as stop:
        return int(stop.code or 0)


@pytest.mark.usefixtures("newcomer")
@pytest.mark.parametrize("arguments", RIGHT, ids=" ".join)
def test_answers_fit(arguments: list[str], capsys: pytest.CaptureFixture[str]) -> None:
    assert typed(arguments) == 0
    said = capsys.readouterr()
    assert said.out.strip()
    assert too_wide(said.out + said.err) == []


@pytest.mark.usefixtures("newcomer")
@pytest.mark.parametrize("arguments", WRONG, ids=" ".join)
def test_mistakes_are_explained_and_fit(
    arguments: list[str], capsys: pytest.CaptureFixture[str]
) -> None:
    before = sorted(Path().iterdir())
    assert typed(arguments) == 2
    said = capsys.readouterr()
    assert said.err.startswith("stereogs: ")
    assert "\n  fix    " in said.err, "what to do"
    assert too_wide(said.out + said.err) == []
    assert sorted(Path().iterdir()) == before
