"""What `stereogs compare` prints and writes."""

from __future__ import annotations

import csv
import io
import json
from pathlib import Path

import pytest
import torch

from registry.toolkit.drawing import ViewPictures, save_png, side_by_side
from stereogs.experiments.comparing.comparability import comparable_groups
from stereogs.experiments.comparing.comparison import read_run
from tests.host import main, parse_command
from tests.html_page import Page
from tests.registry.conftest import TOY_ENTRIES, Install
from tests.stereogs.experiments.comparing.conftest import Capture, Make


def test_the_table(make: Make, capsys: Capture) -> None:
    flower = {"scene/name": "flower", "test/psnr": 26.0}
    folders = [make("a"), make("b", flower)]
    assert main(["compare", *map(str, folders)]) == 0
    lines = [line.split() for line in capsys.readouterr().out.splitlines() if line.strip()]
    assert lines[0] == ["protocol", "llff-3"]
    assert lines[1][:6] == ["run", "method", "scene", "psnr", "ssim", "lpips"]
    dash = "–"  # noqa: RUF001
    assert ["a", "plain", "fern", "20.00", "0.700", dash, "1,000", "60", "500"] in lines
    assert ["plain", "mean", "of", "2", "23.00", "0.700", dash, "1,000", "60", "500"] in lines


def test_runs_that_differ_only_in_the_seed_have_their_mean(make: Make, capsys: Capture) -> None:
    seeds = [make(f"s{n}", {"test/psnr": 20.0 + n}, {"training/seed": n}) for n in range(3)]
    again = make("again", {"test/psnr": 20.0})  # of seed 0: counts once
    other = make("other", None, {"training/iterations": 5})
    assert main(["compare", *map(str, [*seeds, again, other])]) == 0
    output = capsys.readouterr().out
    (line,) = (" ".join(row.split()) for row in output.splitlines() if "mean of" in row)
    assert line.startswith("1000 iterations fern, mean of 3 seeds 21.00 ± 2.48 0.700 ± 0.000 –")  # noqa: RUF001
    assert "95% confidence interval" in output


def test_runs_that_are_not_comparable_have_separate_tables(make: Make, capsys: Capture) -> None:
    folders = [make("a"), make("b", {"protocol": None}), make("c"), make("d", {"scene/width": 9})]
    groups = comparable_groups([read_run(folder) for folder in folders])
    assert [[run.folder.name for run in members] for members, _ in groups] == [
        ["a", "c"],
        ["b"],
        ["d"],
    ]
    assert groups[0][1] == ""
    assert main(["compare", *map(str, folders)]) == 0
    output = " ".join(capsys.readouterr().out.split())
    assert "the protocol 'llff-3', the other no protocol." in output
    assert "'fern' differs in `width`: 504 and 9." in output


def test_csv_has_all_digits(make: Make, capsys: Capture) -> None:
    folder = make("a", {"test/psnr": 20.123456789})
    assert main(["compare", str(folder), "--format", "csv"]) == 0
    (row,) = csv.DictReader(io.StringIO(capsys.readouterr().out))
    assert (row["run"], row["method"], row["scene"]) == (str(folder), "plain", "fern")
    assert (row["psnr"], row["lpips"], row["gaussians"]) == ("20.123456789", "", "1000")
    assert main(["compare", str(folder), "--paper", "stereogs", "--format", "csv"]) == 2


def test_markdown_and_latex_contain_the_table(make: Make, capsys: Capture) -> None:
    folders = [str(make("a|1")), str(make("b_2", {"scene/name": "flower", "test/psnr": 26.0}))]
    assert main(["compare", *folders, "--format", "markdown"]) == 0
    lines = capsys.readouterr().out.splitlines()
    assert (
        "| run | method | scene | psnr | ssim | lpips | Gaussians | seconds | memory MB |" in lines
    )
    assert r"| a\|1 | plain | fern | 20.00 |" in "\n".join(lines)
    assert main(["compare", *folders, "--format", "latex"]) == 0
    output = capsys.readouterr().out
    assert r"\begin{tabular}{lllrrrrrr}" in output
    assert r"b\_2 & plain & flower & 26.00 & 0.700 & -- & 1,000 & 60 & 500 \\" in output


def test_the_page_contains_the_tables_and_the_renders_of_each_view(
    make: Make, capsys: Capture
) -> None:
    changes = {
        "scene/test": ["one", "two"],
        "scene/train": [],
        "test": {"psnr": 21.0},
        "views": {"test": {"one": {"psnr": 20.0}, "two": {"psnr": 22.0}}},
    }
    folders = [make(name, changes) for name in ("a", "<b>")]
    for folder, view in ((folders[0], "one"), (folders[0], "two"), (folders[1], "two")):
        files = ViewPictures.of(view, folder / "renders")
        for file in (files.depth, files.comparison):
            file.parent.mkdir(parents=True, exist_ok=True)
        grey = torch.full((6, 8, 3), 0.5)
        save_png(grey, files.render)
        save_png(grey, files.depth)
        save_png(side_by_side(grey, grey, grey), files.comparison)
    assert main(["compare", *map(str, folders), "--format", "page"]) == 0
    text = capsys.readouterr().out
    page = Page(text)
    assert page.tags.count("option") == 2, "two views to choose from"
    alts = [image["alt"] for image in page.images]
    assert alts == ["photograph", "render", "depth", "photograph", *["render", "depth"] * 2]
    assert all(source.startswith("data:") for source in page.loads)
    assert "<b>: " in page.text
    assert "<b>: " not in text


def test_no_means_for_methods_on_different_scenes(make: Make, capsys: Capture) -> None:
    other = {"name": "other", "training/iterations": 5}
    folders = [
        make("a"),
        make("b", {"scene/name": "flower"}),
        make("c", {"pipeline": "other"}, other),
    ]
    assert main(["compare", *map(str, folders)]) == 0
    output = " ".join(capsys.readouterr().out.split())
    assert "mean of" not in output
    assert "No means" in output
    assert "plain: fern, flower; other: fern" in output


def test_nothing_to_compare(capsys: Capture) -> None:
    assert main(["compare"]) == 2
    assert "nothing to compare" in capsys.readouterr().err


def test_help_has_examples(capsys: Capture) -> None:
    with pytest.raises(SystemExit) as caught:
        parse_command(["compare", "--help"])
    assert caught.value.code == 0
    assert "stereogs compare" in capsys.readouterr().out.split("examples:")[1]


@pytest.mark.proof
def test_real_runs_are_compared(
    install: Install, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: Capture
) -> None:
    install("toys", "1.5", TOY_ENTRIES)
    monkeypatch.chdir(tmp_path)
    Path("toy.yaml").write_text(
        "name: toy\nscene: toy_scene\ninitializer: toy_points\nmetrics: [psnr]\n"
        "training: {iterations: 3, sh_degree: 0}\n"
    )
    for name, change in (("a", "training.seed=1"), ("b", "training.seed=2"), ("c", "metrics=[]")):
        assert main(["train", "toy.yaml", "--out", name, "--set", change]) == 0
    facts = json.loads(Path("a/results.json").read_text())
    assert facts["protocol"] is None
    assert facts["metrics"]["psnr"]["use"] == "psnr"
    assert facts["metrics"]["psnr"]["package"].startswith("toys 1.5, code ")
    assert facts["scene"]["background"] == [0.0, 0.0, 0.0]
    capsys.readouterr()
    assert main(["compare", "a", "b", "c"]) == 0
    output = capsys.readouterr().out
    assert [output.count(f"seed {seed}") for seed in (0, 1, 2)] == [1, 1, 1]
    assert f"{facts['gaussians']:,}" in output
