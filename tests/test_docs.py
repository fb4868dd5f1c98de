"""The documentation is correct: its Python runs, its commands parse, its links lead somewhere."""

from __future__ import annotations

import json
import re
import runpy
import shlex
import subprocess
import sys
import tomllib
from pathlib import Path

import pytest
import yaml

from tests.host import SELECTION, Plugins, TrainingSettings, main, parse_command
from tests.packages import importable, install

ROOT = Path(__file__).parent.parent
PAGES = sorted([ROOT / "README.md", ROOT / "CONTRIBUTING.md", *(ROOT / "docs").glob("*.md")])


def blocks(page: Path, language: str) -> list[str]:
    return re.findall(
        rf"^```{language}\n(.*?)^```", page.read_text("utf-8"), re.DOTALL | re.MULTILINE
    )


def commands(page: Path) -> list[str]:
    lines = (line for block in blocks(page, "sh") for line in block.splitlines())
    return [line.strip() for line in lines if line.strip().startswith("stereogs ")]


@pytest.mark.parametrize("page", PAGES, ids=lambda page: page.name)
def test_links_lead_somewhere(page: Path) -> None:
    for target in re.findall(r"\]\(([^)#]+)(?:#[^)]*)?\)", page.read_text("utf-8")):
        if not target.startswith(("http://", "https://")):
            assert (page.parent / target).exists(), f"{page.name} links to {target}"


@pytest.mark.parametrize("page", PAGES, ids=lambda page: page.name)
def test_commands_are_understood(page: Path) -> None:
    for command in commands(page):
        parse_command(shlex.split(command, comments=True)[1:])


@pytest.mark.parametrize("page", [p for p in PAGES if p.name == "tutorial.md"])
def test_python_examples_run(page: Path, capsys: pytest.CaptureFixture[str]) -> None:
    for source in blocks(page, "python"):
        exec(compile(source, str(page), "exec"), {"__name__": "example"})
    assert capsys.readouterr().out


def test_the_page_on_python_is_right(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    page = ROOT / "docs" / "python.md"
    monkeypatch.chdir(tmp_path)
    names: dict[str, object] = {"__name__": "example"}
    for source in blocks(page, "python"):
        exec(compile(source, str(page), "exec"), names)
    scores, _, shapes, opened, stopped = capsys.readouterr().out.splitlines()
    assert float(scores.split()[0]) > 15
    assert shapes.startswith("(48, 64, 3) (48, 64)")
    assert opened.startswith("True")
    assert stopped == "False 30 True"


def test_the_plugin_of_the_readme_installs_and_trains(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    page, package = ROOT / "README.md", tmp_path / "package"
    files = {"py": "opaque.py", "toml": "pyproject.toml", "yaml": "opaque.yaml"}
    package.mkdir()
    for language, name in files.items():
        (text,) = blocks(page, language)
        (package / name).write_text(text, "utf-8")
        assert f"`{name}`" in page.read_text("utf-8")
    small = ["scene.width=32", "scene.height=24", "training.iterations=4"]
    options = [word for change in small for word in ("--set", change)]
    monkeypatch.chdir(package)
    with importable(install([package], tmp_path), monkeypatch):
        assert main(["train", "opaque.yaml", "--out", "run", *options]) == 0
    lines = (package / "run" / "metrics.jsonl").read_text("utf-8").splitlines()
    assert json.loads(lines[-1])["regularizers.opaque"] > 0


def test_citation_and_distributions_are_of_one_version() -> None:
    citation = yaml.safe_load((ROOT / "CITATION.cff").read_text("utf-8"))
    project, engine = (
        tomllib.loads((ROOT / folder / "pyproject.toml").read_text("utf-8"))["project"]
        for folder in (".", "core_rasterizer")
    )
    for key in ("version", "license", "requires-python"):
        assert project[key] == engine[key] == citation.get(key, engine[key])
    assert f"{engine['name']}=={engine['version']}" in project["dependencies"]
    pythons = [[c for c in p["classifiers"] if "Python" in c] for p in (project, engine)]
    assert pythons[0] == pythons[1]


def test_the_tutorial_shows_commands() -> None:
    assert len(commands(ROOT / "docs" / "tutorial.md")) >= 5


@pytest.mark.proof
def test_fitting_one_picture_gets_better(tmp_path: Path) -> None:
    from PIL import Image
    from skimage import data

    picture = tmp_path / "small.png"
    Image.fromarray(data.coffee()).resize((60, 40)).save(picture)
    script = ROOT / "docs" / "examples" / "fit_one_picture.py"
    output = subprocess.run(
        [sys.executable, str(script), str(picture), "200"],
        cwd=tmp_path,
        env={"PYTHONPATH": str(ROOT), "PATH": "/usr/bin:/bin", "HOME": str(Path.home())},
        capture_output=True,
        text=True,
        check=True,
    ).stdout
    first, last = (float(value) for value in re.findall(r"PSNR ([\d.]+)", output))
    assert last > max(first, 20)
    assert (tmp_path / "fitted.png").is_file()


def test_the_generated_page_lists_every_component_and_setting(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.delenv(SELECTION, raising=False)
    page = runpy.run_path(str(ROOT / "docs" / "make_reference.py"))["page"]()
    sections = dict(re.findall(r"^## `(\w+)`(.*?)(?=^## |\Z)", page, re.DOTALL | re.MULTILINE))
    offers = [offer for offer in Plugins().all() if offer.distribution == "stereogs-plugins"]
    assert len(offers) > 80
    for offer in offers:
        _, _, text = sections[offer.point.section].partition(f"\n### {offer.name}\n")
        text = text.partition("\n### ")[0]
        assert text, offer.name
        for setting in offer.settings_type.model_fields:
            assert f"\n| `{setting}` |" in text, f"{offer.name}.{setting}"
    for setting in TrainingSettings.model_fields:
        assert f"\n| `{setting}` |" in sections["training"]


@pytest.mark.parametrize("page", PAGES, ids=lambda page: page.name)
def test_no_line_is_too_long_to_read(page: Path) -> None:
    """Rows of tables cannot be wrapped."""
    lines = page.read_text("utf-8").splitlines()
    assert [line for line in lines if len(line) > 140 and not line.startswith("|")] == []
