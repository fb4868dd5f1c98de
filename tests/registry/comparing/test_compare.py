"""Runs side by side; what cannot be compared is refused with the reason."""

from __future__ import annotations

import copy
import csv
import io
import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest
import torch

from registry import RunError
from registry.cli import build_parser, main
from registry.comparing.comparability import check_comparable, comparable_groups
from registry.comparing.comparison import FinishedRun, method_means, read_run
from registry.comparing.differences import labels
from registry.comparing.paper_tables import GROUP
from registry.drawing.pictures import ViewPictures, save_png, side_by_side
from registry.pipeline.protocol_rules import AppliedProtocol
from registry.pipeline.protocols import load_protocol
from registry.pipeline.yaml_source import to_yaml
from registry.runs.folder import RunFolder

from ...html_page import Page
from ..conftest import TOY_ENTRIES, Install

Capture = pytest.CaptureFixture[str]
Make = Callable[..., Path]

RESULTS: dict[str, Any] = {
    "pipeline": "plain",
    "protocol": AppliedProtocol(load_protocol("llff-3"), {}).record(),
    "scene": {
        "name": "fern",
        "train": ["image001", "image010", "image019"],
        "test": ["image000", "image008", "image016"],
        "width": 504,
        "height": 378,
        "extent": 4.25,
        "points": 700,
        "facts": {"source": "images_8"},
        "notes": {"dark_background": "kept"},
    },
    "metrics": {
        "psnr": {"use": "psnr", "quantize": "png8"},
        "lpips": {"use": "lpips", "quantize": "png8", "sha256": None},
    },
    "gaussians": 1000,
    "seconds": 60.0,
    "peak_memory_mb": 500.0,
    "test": {"psnr": 20.0, "ssim": 0.7, "lpips": None},
}
PIPELINE: dict[str, Any] = {
    "name": "plain",
    "scene": {"use": "llff", "path": "fern", "train_views": 3},
    "initializer": {"use": "sfm"},
    "metrics": [{"use": "psnr"}],
    "training": {"iterations": 1000, "seed": 0},
}


def changed(base: dict[str, Any], changes: dict[str, Any]) -> dict[str, Any]:
    """A copy with values at dotted keys; `...` removes one."""
    result = copy.deepcopy(base)
    for path, value in changes.items():
        *parents, last = path.split("/")
        place = result
        for parent in parents:
            place = place[parent]
        place[last] = value
        if value is ...:
            del place[last]
    return result


@pytest.fixture
def make(tmp_path: Path) -> Make:
    """`make("a", {"scene/name": "flower"}, {"training/seed": 1})` writes a run folder."""

    def make(
        name: str, results: dict[str, Any] | None = None, pipeline: dict[str, Any] | None = None
    ) -> Path:
        run = RunFolder(tmp_path / name)
        run.create(to_yaml(changed(PIPELINE, pipeline or {})), {}, {}, lambda folder: None)
        run.write_results(changed(RESULTS, results or {}))
        return run.path

    return make


def refusal(*folders: Path) -> RunError:
    with pytest.raises(RunError) as caught:
        check_comparable([read_run(folder) for folder in folders])
    for folder in folders[-2:]:
        assert str(folder) in caught.value.where
    assert caught.value.fix
    return caught.value


def runs(*folders: Path) -> list[FinishedRun]:
    found = [read_run(folder) for folder in folders]
    check_comparable(found)
    return found


def test_runs_of_one_protocol_are_compared(make: Make) -> None:
    flower = {"scene/name": "flower", "scene/width": 500, "scene/test": ["image000", "image008"]}
    repeated = {
        "scene/points": 3,
        "scene/extent": 4.25 * (1 + 1e-9),
        "scene/notes": {"dark_background": "black"},
    }
    assert len(runs(make("a"), make("b", flower), make("c", repeated))) == 3


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"protocol": None}, "the protocol 'llff-3', the other no protocol"),
        ({"protocol/name": "llff-6"}, "the other the protocol 'llff-6'"),
        (
            {"protocol/modified": {"scene.downsample": 4}},
            "the other the protocol 'llff-3, scene.downsample=4'",
        ),
        ({"protocol/scale": "1/4"}, "had another `scale`"),
        (
            {"protocol/loaders/llff/train_views": 4},
            "'llff-3' had another `loaders.llff.train_views` when the other was run",
        ),
        ({"scene/width": 252}, "'fern' differs in `width`: 504 and 252"),
        ({"scene/test": ["image000", "image008"]}, "differs in `test`"),
        ({"scene/extent": 4.3}, "differs in `extent`"),
        ({"scene/facts/source": "images"}, "differs in `facts.source`: images_8 and images"),
        ({"scene/facts/masks": "none"}, "differs in `facts.masks`: None and none"),
        (
            {"metrics/psnr/quantize": "float"},
            "psnr was measured with `quantize` 'png8' and 'float'",
        ),
    ],
)
def test_runs_that_cannot_be_compared(make: Make, changes: dict[str, Any], message: str) -> None:
    assert message in refusal(make("a"), make("b", changes)).what


def test_what_a_protocol_says_to_people_may_change(make: Make) -> None:
    runs(make("a"), make("b", {"protocol/notes": "another sentence", "protocol/title": "LLFF"}))


LEGO = {
    "scene/name": "lego",
    "protocol": AppliedProtocol(load_protocol("blender-8"), {}).record(),
}
OLD_VIEWS = {"protocol/loaders/blender/train_ids": [26, 86, 2, 55, 75, 93, 16, 73]}


def test_records_of_another_list_of_views_under_one_name_are_told_apart(
    make: Make, capsys: Capture
) -> None:
    new, old = make("new", LEGO), make("old", LEGO | OLD_VIEWS)
    assert "had another `loaders.blender.train_ids`" in refusal(new, old).what
    assert main(["compare", str(new), "--paper", "stereogs"]) == 0
    capsys.readouterr()
    assert main(["compare", str(old), "--paper", "stereogs"]) == 2
    said = capsys.readouterr().err
    assert "the protocol 'blender-8' has changed since this run: `loaders.blender.train_ids`" in (
        said
    )


def test_two_scenes_need_a_protocol(make: Make) -> None:
    free = {"protocol": None}
    runs(make("a", free), make("b", free))
    error = refusal(make("c", free), make("d", {**free, "scene/name": "flower"}))
    assert "'fern' and 'flower' and follow no protocol" in error.what


def test_a_difference_between_later_runs_is_found(make: Make) -> None:
    flower = {"scene/name": "flower"}
    other = {**flower, "scene/height": 100}
    assert "'flower' differs" in refusal(make("a"), make("b", flower), make("c", other)).what


def test_settings_of_a_metric_matter_only_where_both_have_a_score(make: Make) -> None:
    measured = {"test/lpips": 0.2, "metrics/lpips/sha256": "ab"}
    other = {"test/lpips": 0.2, "metrics/lpips/sha256": "cd"}
    runs(make("a"), make("b", measured))
    assert "lpips was measured with `sha256`" in refusal(make("c", measured), make("d", other)).what


def test_a_run_without_results_is_explained(make: Make, tmp_path: Path) -> None:
    folder = make("a")
    (folder / "results.json").unlink()
    with pytest.raises(RunError, match="has not ended"):
        read_run(folder)
    with pytest.raises(RunError, match="does not say metrics, gaussians"):
        read_run(make("b", {"metrics": ..., "gaussians": ...}))
    with pytest.raises(RunError, match="does not say the scene's facts"):
        read_run(make("c", {"scene/facts": ...}))
    with pytest.raises(RunError, match="not a run folder"):
        read_run(tmp_path)


def test_means_go_over_repetitions_first_and_then_over_scenes(make: Make) -> None:
    flower = {"scene/name": "flower", "test/psnr": 26.0, "gaussians": 4000}
    again = {"test/psnr": 21.0, "gaussians": 3000}
    (mean,) = method_means(
        runs(
            make("a"),
            make("b", again, {"training/seed": 1, "metrics": []}),
            make("c", flower, {"scene/path": "flower"}),
        )
    )
    assert (mean.method, mean.scenes) == ("plain", ("fern", "flower"))
    assert mean.numbers["psnr"] == pytest.approx((20.5 + 26) / 2)
    assert mean.numbers["gaussians"] == pytest.approx((2000 + 4000) / 2)
    assert mean.numbers["lpips"] is None


def test_a_mean_needs_the_score_in_every_scene(make: Make) -> None:
    flower = {"scene/name": "flower", "test/lpips": 0.2}
    (mean,) = method_means(runs(make("a"), make("b", flower)))
    assert mean.numbers["lpips"] is None


def test_pipelines_that_differ_are_two_methods(make: Make) -> None:
    means = method_means(runs(make("a"), make("b", None, {"training/iterations": 2000})))
    assert [mean.method for mean in means] == ["plain (a)", "plain (b)"]


def test_observers_make_no_difference(make: Make) -> None:
    watched = {"observers": [{"use": "diary", "every": 5}]}
    found = runs(make("a"), make("b", {"scene/name": "flower"}, watched))
    assert [mean.method for mean in method_means(found)] == ["plain"]
    assert labels(found) == ["plain", "plain"]


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


def test_runs_of_one_pipeline_are_told_apart(make: Make, capsys: Capture) -> None:
    longer = {"training/iterations": 2000, "training/seed": 1}
    many = {**longer, "initializer/use": "random", "scene/train_views": 6}
    other = {"name": "other"}
    found = runs(make("a"), make("b", None, longer), make("c", {"pipeline": "other"}, other))
    assert labels(found) == [
        "plain, training.iterations=1000, training.seed=0",
        "plain, training.iterations=2000, training.seed=1",
        "other",
    ]
    assert labels(runs(make("d"), make("e", None, many)))[1] == (
        "plain, scene.train_views=6, initializer.use=random, training.iterations=2000, 1 more"
    )
    weights = [{"metrics": [{"use": "psnr", "quantize": q}]} for q in ("png8", None)]
    assert labels(runs(make("f", None, weights[0]), make("g", None, weights[1]))) == [
        "plain, metrics.psnr.quantize=png8",
        "plain, metrics.psnr.quantize=null",
    ]


def test_what_cannot_be_compared_stands_in_tables_of_its_own(make: Make, capsys: Capture) -> None:
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


def test_csv_has_every_digit(make: Make, capsys: Capture) -> None:
    folder = make("a", {"test/psnr": 20.123456789})
    assert main(["compare", str(folder), "--format", "csv"]) == 0
    (row,) = csv.DictReader(io.StringIO(capsys.readouterr().out))
    assert (row["run"], row["method"], row["scene"]) == (str(folder), "plain", "fern")
    assert (row["psnr"], row["lpips"], row["gaussians"]) == ("20.123456789", "", "1000")
    assert main(["compare", str(folder), "--paper", "stereogs", "--format", "csv"]) == 2


def test_markdown_and_latex_hold_the_table(make: Make, capsys: Capture) -> None:
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


def test_the_page_holds_the_tables_and_the_renders_of_each_view(
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


def test_no_means_where_methods_saw_different_scenes(make: Make, capsys: Capture) -> None:
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


def test_published_rows_stand_beside_ours(make: Make, capsys: Capture) -> None:
    assert main(["compare", str(make("a")), "--paper", "stereogs"]) == 0
    output = capsys.readouterr().out
    rows = [line.split() for line in output.splitlines()]
    assert ["a", "plain", "fern"] in [row[:3] for row in rows]
    expected = ["published", "StereoGS", "mean", "of", "8", "21.91", "0.773", "0.157", "126,000"]
    assert expected in [row[:9] for row in rows]
    text = " ".join(output.split())
    assert "means over fern, flower, fortress, horns, leaves, orchids, room, trex" in text
    assert "Ours: fern. A mean over other scenes is no reproduction." in text


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
            "not said which of the paper's numbers are wanted: the runs follow",
        ),
        ({"protocol/modified": {"scene.downsample": 4}}, [], "scene.downsample=4"),
        ({}, ["--protocol", "lff-3"], "nothing for 'lff-3'; did you mean 'llff-3'"),
        ({}, ["--paper", "stereo"], "no tables of a paper 'stereo' are installed; did you mean"),
    ],
)
def test_published_numbers_of_another_protocol_are_refused(
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


def test_any_package_may_bring_tables(
    make: Make, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: Capture
) -> None:
    bring(tmp_path, monkeypatch, TABLES, "one")
    assert main(["compare", str(make("a")), "--paper", "acme"]) == 0
    output = capsys.readouterr().out
    assert "33.50" in output
    assert "Published: A paper" in output
    bring(tmp_path, monkeypatch, TABLES, "two")
    assert main(["compare", str(tmp_path / "a"), "--paper", "acme"]) == 2
    assert "brought twice: by two and one" in capsys.readouterr().err


def test_tables_are_checked(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: Capture
) -> None:
    bring(tmp_path, monkeypatch, TABLES.replace("33.5", "33.5, 0.9"), "three")
    assert main(["compare", "--paper", "acme", "--protocol", "llff-3"]) == 2
    assert "each row has 1 numbers" in capsys.readouterr().err


def test_nothing_to_compare(capsys: Capture) -> None:
    assert main(["compare"]) == 2
    assert "nothing to compare" in capsys.readouterr().err


def test_help_has_examples(capsys: Capture) -> None:
    with pytest.raises(SystemExit) as caught:
        build_parser().parse_args(["compare", "--help"])
    assert caught.value.code == 0
    assert "stereogs compare" in capsys.readouterr().out.split("examples:")[1]


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
    assert facts["metrics"] == {"psnr": {"use": "psnr"}}
    assert facts["scene"]["background"] == [0.0, 0.0, 0.0]
    capsys.readouterr()
    assert main(["compare", "a", "b", "c"]) == 0
    output = capsys.readouterr().out
    assert output.count("toy") == 3
    assert f"{facts['gaussians']:,}" in output
