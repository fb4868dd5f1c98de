"""Ready pipelines: found by name among what packages bring."""

from __future__ import annotations

import tomllib
from importlib.metadata import EntryPoint
from pathlib import Path

import pytest

from registry.pipeline import ready
from registry.pipeline.ready import find_pipeline, ready_pipelines
from tests.host import PipelineError

ROOT = Path(__file__).parents[3]


def bring(monkeypatch: pytest.MonkeyPatch, site: Path, *packages: str) -> None:
    """Install packages with a folder of pipelines, as entry points of the group."""
    entries = []
    for package in packages:
        (site / package / "more").mkdir(parents=True)
        for name in ("plain", "more/fancy"):
            (site / package / f"{name}.yaml").write_text(f"name: {package}")
        entries.append(EntryPoint(package, package, ready.PIPELINES))
    monkeypatch.syspath_prepend(str(site))
    monkeypatch.setattr(ready, "entry_points", lambda group: entries)
    monkeypatch.setattr(ready, "packaged_files", ready.packaged_files.__wrapped__)  # not cached


def test_the_projects_own_are_all_there() -> None:
    files = (ROOT / "pipelines").rglob("*.yaml")
    names = {file.relative_to(ROOT / "pipelines").with_suffix("").as_posix() for file in files}
    assert {"demo", "3dgs", "ablations/parts"} <= names
    ours = {name for name, found in ready_pipelines().items() if ROOT in found[0].parents}
    assert ours == names


def test_the_wheel_takes_every_folder_of_them() -> None:
    patterns = tomllib.loads((ROOT / "pyproject.toml").read_text("utf-8"))["tool"]["setuptools"][
        "package-data"
    ]["stereogs_plugins"]
    package = ROOT / "stereogs_plugins"
    packed = {file for pattern in patterns for file in package.glob(pattern)}
    assert {package / "pipelines" / f"{name}.yaml" for name in ready_pipelines()} <= packed


def test_a_name_leads_to_its_file(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    bring(monkeypatch, tmp_path, "acme_pipelines_1")
    assert list(ready_pipelines()) == ["more/fancy", "plain"]
    folder = tmp_path / "acme_pipelines_1"
    assert find_pipeline(Path("more/fancy")) == folder / "more" / "fancy.yaml"


def test_a_file_that_is_there_comes_first(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    bring(monkeypatch, tmp_path, "acme_pipelines_2")
    monkeypatch.chdir(tmp_path)
    Path("plain").touch()
    assert find_pipeline(Path("plain")) == Path("plain")
    assert find_pipeline(Path("none.yaml")) == Path("none.yaml")


def test_mistakes(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    bring(monkeypatch, tmp_path, "acme_pipelines_3", "acme_pipelines_4")
    with pytest.raises(PipelineError, match="did you mean 'plain'") as caught:
        find_pipeline(Path("plane"))
    assert "one of: plain; more are in more" in caught.value.fix
    with pytest.raises(PipelineError, match="provided by several packages"):
        find_pipeline(Path("plain"))
