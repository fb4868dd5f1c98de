"""`stereogs new-plugin`: each kind's package installs, keeps the contract and has a pipeline that trains.

NEW_PLUGINS=all (`make new-plugins`) also installs each with pip alone, runs its own tests and trains it.
"""

from __future__ import annotations

import os
from collections.abc import Iterator
from importlib import metadata
from pathlib import Path

import pytest

from registry import PluginError
from stereogs.testing import check, check_command
from stereogs.verbs.new_plugin.package_files import (
    CAPABILITIES,
    COMMAND,
    COMPONENTS,
    KINDS,
    OWN,
    PRIOR,
    new_plugin,
)
from stereogs.verbs.new_plugin.verb import NewPlugin
from tests.host import (
    SELECTION,
    Plugins,
    installed_entries,
    load_pipeline,
    main,
    offered_name,
    verbs,
)
from tests.packages import ROOT, importable, install, install_by_pip, run_python

NAMES = {kind: f"my_{kind[:5]}-2" for kind in KINDS}
NAMES |= {capability: f"my_{capability}" for capability in CAPABILITIES}
POINTS = {**COMPONENTS, **dict.fromkeys(CAPABILITIES, COMPONENTS[PRIOR])}
"""Of a component of each kind, and of a prior of each capability."""


def folder_of(kind: str) -> str:
    return f"stereogs-{NAMES[kind].replace('_', '-')}"


thorough = pytest.mark.skipif(os.environ.get("NEW_PLUGINS") != "all", reason="make new-plugins")


@pytest.fixture(scope="module")
def written(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A package of each kind, and of a prior of each capability, as the command writes it."""
    folder = tmp_path_factory.mktemp("new")
    for kind in KINDS:
        new_plugin(NAMES[kind], kind, folder)
    for capability in CAPABILITIES:
        new_plugin(NAMES[capability], PRIOR, folder, capability)
    return folder


@pytest.fixture(scope="module")
def site(written: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """All of them installed."""
    return install(list(written.iterdir()), tmp_path_factory.mktemp("installed"))


@pytest.fixture
def installed(site: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[Plugins]:
    """The plugins that ship, and all new ones."""
    with importable(site, monkeypatch) as plugins:
        yield plugins


@pytest.mark.proof
@pytest.mark.parametrize("kind", POINTS)
def test_it_installs_and_keeps_the_contract(kind: str, installed: Plugins) -> None:
    offer = installed.find(POINTS[kind], NAMES[kind])
    assert offer.distribution == folder_of(kind)
    assert metadata.version(offer.distribution) == offer.version
    if kind in CAPABILITIES and kind != OWN:
        assert getattr(offer.component, "capability", None) == kind
    check(
        offer.component,
        call=(lambda prior, scene: prior.sharpness(scene.train[0].image)) if kind == OWN else None,
    )


@pytest.mark.proof
def test_its_pipeline_uses_it(written: Path, installed: Plugins) -> None:
    for kind, point in POINTS.items():
        name = NAMES[kind]
        pipeline = load_pipeline(written / folder_of(kind) / "pipeline.yaml", installed)
        assert name in [item.offer.name for item in pipeline.items[point.section]]
        assert pipeline.items["metrics"]


def test_a_command_installs_and_keeps_the_contract(
    written: Path,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    name, files = NAMES[COMMAND], tmp_path / "files"
    site = install([written / folder_of(COMMAND)], tmp_path)
    files.mkdir()
    (files / "one").touch()
    with importable(site, monkeypatch):
        verb = verbs()[name]
        assert verb.summary == "print the number of files in a folder"
        check_command(type(verb.load()))
        assert main([name, str(files)]) == 0
        assert capsys.readouterr().out == "1\n"
        assert main([name, str(files / "one")]) == 2
        assert "not a folder" in capsys.readouterr().err


def test_what_is_written_is_well_formatted(written: Path) -> None:
    rules = ("--config", str(ROOT / "pyproject.toml"), "--no-cache")
    run_python("-m", "ruff", "check", *rules, "--ignore", "I", str(written), folder=written)
    run_python("-m", "ruff", "format", "--check", *rules, str(written), folder=written)


def test_the_help_names_every_kind() -> None:
    said = NewPlugin.epilog.split("examples:")[0]
    assert all(name in said for name in (*KINDS, *CAPABILITIES))


def test_the_command_writes_beside_what_is_there(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(tmp_path)
    assert main(["new-plugin", "solid", "--kind", "regularizer"]) == 0
    assert "stereogs-solid" in capsys.readouterr().out
    assert (tmp_path / "stereogs-solid" / "stereogs_solid.py").is_file()
    assert main(["new-plugin", "solid", "--kind", "regularizer"]) == 2
    assert "folder exists and is not empty" in capsys.readouterr().err
    assert [path.name for path in tmp_path.iterdir()] == ["stereogs-solid"]


@pytest.mark.parametrize(
    ("name", "kind", "message"),
    [
        ("solid", "regulariser", "did you mean 'regularizer'"),
        ("Solid", "regularizer", "not a valid name"),
        ("2d", "regularizer", "not a valid name"),
        ("", "regularizer", "not a valid name"),
        ("../up", "regularizer", "not a valid name"),
    ],
)
def test_what_cannot_be_is_refused(name: str, kind: str, message: str, tmp_path: Path) -> None:
    with pytest.raises(PluginError, match=message):
        new_plugin(name, kind, tmp_path)
    assert not list(tmp_path.iterdir())


def test_a_capability_is_of_a_prior(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    for kind, capability, message in (
        (PRIOR, "normal", "did you mean 'normals'"),
        ("metric", "normals", "a metric has no capability"),
    ):
        with pytest.raises(PluginError, match=message):
            new_plugin("walls", kind, tmp_path, capability)
    options = ["--kind", PRIOR, "--capability", "gaussians", "--into", str(tmp_path)]
    assert main(["new-plugin", "walls", *options]) == 0
    assert "GaussiansPrior" in (tmp_path / "stereogs-walls" / "stereogs_walls.py").read_text()


def test_a_command_of_an_installed_name_is_refused(tmp_path: Path) -> None:
    for name in ("compare", "train"):
        with pytest.raises(
            PluginError, match=f"a command '{name}' is installed, offered by stereogs"
        ):
            new_plugin(name, COMMAND, tmp_path)


def test_a_name_that_is_installed_is_refused(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.delenv(SELECTION)
    name = offered_name(installed_entries()[0])
    with pytest.raises(PluginError, match="is installed, offered by stereogs-plugins"):
        new_plugin(name, "prior", tmp_path)


@thorough
@pytest.mark.parametrize("kind", NAMES)
def test_it_passes_its_own_tests_and_trains(kind: str, written: Path, tmp_path: Path) -> None:
    package = written / folder_of(kind)
    site = install_by_pip(package, tmp_path)
    tests = ("-m", "pytest", "-q", "-p", "no:cacheprovider", str(package))
    run_python(*tests, folder=tmp_path, site=site)
    run_python("-m", "stereogs", "plugins", "--check", folder=tmp_path, site=site)
    if kind == COMMAND:
        run_python("-m", "stereogs", NAMES[kind], ".", folder=tmp_path, site=site)
        return
    pipeline = str(package / "pipeline.yaml")
    run_python("-m", "stereogs", "train", pipeline, "--out", "run", folder=tmp_path, site=site)
    assert (tmp_path / "run" / "results.json").is_file()
