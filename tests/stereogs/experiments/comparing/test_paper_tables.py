"""Published numbers from any package in a comparison."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest

from stereogs.experiments.comparing.paper_tables import GROUP
from tests.host import main
from tests.stereogs.experiments.comparing.conftest import Capture, Make


def test_published_rows_are_added_to_runs(make: Make, capsys: Capture) -> None:
    assert main(["compare", str(make("a")), "--paper", "stereogs"]) == 0
    output = capsys.readouterr().out
    rows = [line.split() for line in output.splitlines()]
    assert ["a", "plain", "fern"] in [row[:3] for row in rows]
    expected = ["published", "StereoGS", "mean", "of", "8", "21.91", "0.773", "0.157", "126,000"]
    assert expected in [row[:9] for row in rows]
    text = " ".join(output.split())
    assert "means over fern, flower, fortress, horns, leaves, orchids, room, trex" in text
    assert "Ours: fern. Means over different scenes are not comparable." in text


def test_published_rows_alone(capsys: Capture) -> None:
    assert main(["compare", "--paper", "stereogs", "--protocol", "blender-8"]) == 0
    output = capsys.readouterr().out
    assert "25.04" in output
    assert "Ours" not in output


@pytest.mark.parametrize(
    ("changes", "more", "message"),
    [
        ({}, ["--protocol", "llff-6"], "for llff-6: it follows llff-3"),
        ({"protocol": None}, ["--protocol", "llff-3"], "it follows no protocol"),
        (
            {"protocol": None},
            [],
            "--paper needs a protocol: the runs follow none",
        ),
        ({"protocol/modified": {"scene.downsample": 4}}, [], "scene.downsample=4"),
        ({}, ["--protocol", "lff-3"], "no numbers for 'lff-3'; did you mean 'llff-3'"),
        ({}, ["--paper", "stereo"], "no tables of a paper 'stereo' are installed; did you mean"),
    ],
)
def test_published_numbers_of_another_protocol_are_rejected(
    make: Make, capsys: Capture, changes: dict[str, Any], more: list[str], message: str
) -> None:
    assert main(["compare", str(make("a", changes)), "--paper", "stereogs", *more]) == 2
    assert message in capsys.readouterr().err


TABLES = """\
source: A paper
metrics: [psnr]
methods: {ours: Ours}
results: {llff-3: {ours: [33.5]}}
"""


def bring(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, text: str, name: str) -> None:
    """Install a package with the tables of a paper."""
    site = tmp_path / f"site-{name}"
    metadata, package = site / f"{name}-1.dist-info", site / f"{name}_tables"
    metadata.mkdir(parents=True)
    package.mkdir()
    (metadata / "METADATA").write_text(f"Metadata-Version: 2.1\nName: {name}\nVersion: 1\n")
    (metadata / "entry_points.txt").write_text(f"[{GROUP}]\nacme = {package.name}\n")
    (package / "__init__.py").touch()
    (package / "acme.yaml").write_text(text)
    monkeypatch.syspath_prepend(site)


def test_any_package_can_provide_tables(
    make: Make, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: Capture
) -> None:
    bring(tmp_path, monkeypatch, TABLES, "one")
    assert main(["compare", str(make("a")), "--paper", "acme"]) == 0
    output = capsys.readouterr().out
    assert "33.50" in output
    assert "Published: A paper" in output
    bring(tmp_path, monkeypatch, TABLES, "two")
    assert main(["compare", str(tmp_path / "a"), "--paper", "acme"]) == 2
    assert "several packages provide the tables of 'acme': two and one" in capsys.readouterr().err


def test_tables_are_checked(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: Capture
) -> None:
    bring(tmp_path, monkeypatch, TABLES.replace("33.5", "33.5, 0.9"), "three")
    assert main(["compare", "--paper", "acme", "--protocol", "llff-3"]) == 2
    assert "each row must have 1 numbers" in capsys.readouterr().err
