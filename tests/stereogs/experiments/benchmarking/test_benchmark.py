"""Benchmarks of a small scene: pipelines and a stand-in for another program."""

from __future__ import annotations

import csv
import json
import shutil
import sys
from pathlib import Path

import pytest

from registry import RunError
from stereogs import ExplainedError
from stereogs.experiments.benchmarking.description import PROGRAMS, Benchmark, read_benchmark
from stereogs.experiments.benchmarking.keeping import TrialFolder, read_records
from stereogs.experiments.benchmarking.snapshots import Snapshots
from stereogs.experiments.benchmarking.tables import tables
from stereogs.experiments.benchmarking.trial import RECORD, TASK, run_trial
from tests.host import SELECTION, Plugins, main
from tests.stereogs_plugins.scenes.small_scenes import World, write_llff

TINY = """\
name: tiny
scene: {use: procedural}
initializer: {use: random, count: 50}
training: {iterations: 4, sh_degree: 0}
"""
PROGRAM = """\
version: echo 17
train: "{python} {script} gaussians {{data}} {{out}}"
gaussians: splat*.ply
layout: colmap
points: {{use: sfm}}
repeat_first: false
timeout: 50
"""
FILE = """\
protocol: {use: llff-3, modified: [scene.test_every, scene.downsample]}
scenes: [./fern]
scene: {downsample: 2, test_every: 4}
entrants: [tiny.yaml, other.yaml]
budgets: [0.001, 500]
seeds: 1
repeats: 1
"""
STAND_IN = Path(__file__).with_name("stand_in.py")


@pytest.fixture
def folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A folder with a benchmark; the working folder."""
    monkeypatch.delenv(SELECTION, raising=False)
    monkeypatch.delenv("STEREOGS_MODELS", raising=False)
    monkeypatch.chdir(tmp_path)
    write_llff(tmp_path / "fern", World())
    (tmp_path / "tiny.yaml").write_text(TINY)
    (tmp_path / "other.yaml").write_text(PROGRAM.format(python=sys.executable, script=STAND_IN))
    (tmp_path / "small.yaml").write_text(FILE)
    return tmp_path


def described(folder: Path, old: str = "", new: str = "") -> Benchmark:
    assert old in FILE
    (folder / "small.yaml").write_text(FILE.replace(old, new))
    return read_benchmark(folder / "small.yaml", Plugins())


def run_in_process(benchmark: Benchmark, out: Path) -> TrialFolder:
    """Run all trials in this process."""
    kept = TrialFolder(out)
    for trial in benchmark.trials:
        task = kept.task(trial, None)
        task.folder.mkdir(parents=True)
        (task.folder / TASK).write_text(task.pipeline)
        record = run_trial(task.folder, started=0.0, device=None)
        (task.folder / RECORD).write_text(json.dumps(record))
    return kept


def changed_record(folder: TrialFolder, benchmark: Benchmark, **changes: object) -> None:
    file = folder.task(benchmark.trials[-1], None).folder / RECORD
    file.write_text(json.dumps({**json.loads(file.read_text()), **changes}))


@pytest.mark.proof
def test_pipelines_and_programs_in_one_table(
    folder: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(["benchmark", "small.yaml", "--out", "out"]) == 0
    printed = capsys.readouterr().out
    assert "2 trials, 0 finished" in printed
    with (folder / "out" / "benchmark.csv").open() as file:
        rows = list(csv.DictReader(file))
    # Nothing is complete after a millisecond.
    assert [(row["entrant"], row["repeat"], row["budget"]) for row in rows] == [
        (entrant, "0", budget) for entrant in ("tiny", "other") for budget in ("500", "end")
    ]
    tiny, other = rows[0], rows[2]
    assert float(tiny["seconds"]) > 0.5  # the imports of a process
    assert tiny["psnr"] == rows[1]["psnr"]
    assert float(other["psnr"]) > 15
    assert float(other["cpu_seconds"]) > 0.1
    text = (folder / "out" / "benchmark.txt").read_text()
    assert text.startswith("llff-3, scene.test_every=4, scene.downsample=2: fern\n")
    assert "other takes no seed" in text
    assert "lpips: " in text
    assert main(["benchmark", "small.yaml", "--out", "out"]) == 0
    assert "2 trials, 2 finished" in capsys.readouterr().out


def test_a_program_sees_the_training_views_only(folder: Path) -> None:
    benchmark = described(folder, "entrants: [tiny.yaml, other.yaml]", "entrants: [other.yaml]")
    kept = run_in_process(benchmark, folder / "out")
    trial = benchmark.trials[0]
    place = kept.task(trial, None).folder
    seen = json.loads((place / "out" / "seen.json").read_text())
    assert [name[-6:-4] for name in seen] == ["01", "03", "07"]
    tests = [f"photo_{index:02d}" for index in (0, 4, 8)]
    assert not [path for path in place.rglob("*") if path.stem in tests]
    record = kept.record(trial)
    assert list(record["end"]["views"]) == tests
    assert record["software"] == {"program": "17"}
    assert set(record["budgets"]) == {"500"}


@pytest.mark.parametrize(
    ("mode", "what"),
    [
        ("silent", "status 0 and left no file that matches 'splat*.ply'"),
        ("failing", "ended with status 3:\nout of luck"),
        ("hanging", "did not end within 2 s; is its viewer open"),
        ("moved", "no better than images of one colour"),
        ("damaged", "splat_1.ply"),
    ],
)
def test_failures_of_a_program(folder: Path, mode: str, what: str) -> None:
    text = (folder / "other.yaml").read_text().replace("py gaussians", f"py {mode}")
    limit = 2 if mode == "hanging" else 50
    (folder / "other.yaml").write_text(text.replace("timeout: 50", f"timeout: {limit}"))
    benchmark = described(folder, "entrants: [tiny.yaml, other.yaml]", "entrants: [other.yaml]")
    with pytest.raises(ExplainedError) as refused:
        run_in_process(benchmark, folder / "out")
    assert what in str(refused.value)


@pytest.mark.parametrize("mode", ["renders", "small", "silent"])
def test_renders_of_a_program(folder: Path, mode: str) -> None:
    text = (folder / "other.yaml").read_text().replace("py gaussians", "py silent")
    render = (
        f'render: "{sys.executable} {STAND_IN} {mode} {{data}} {{out}} {{cameras}} {{renders}}"'
    )
    (folder / "other.yaml").write_text(text.replace("gaussians: splat*.ply", render))
    benchmark = described(folder, "entrants: [tiny.yaml, other.yaml]", "entrants: [other.yaml]")
    if mode == "renders":
        kept = run_in_process(benchmark, folder / "out")
        record = kept.record(benchmark.trials[0])
        assert record["end"]["test"]["psnr"] > 10
        assert record["budgets"]["500"] == record["end"]
        return
    what = {"small": "32x24 pixels, not 64x48", "silent": "left no render of this view"}[mode]
    with pytest.raises(RunError, match=what):
        run_in_process(benchmark, folder / "out")


@pytest.fixture(scope="module")
def finished(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The trials of `test_records_that_are_refused`."""
    return tmp_path_factory.mktemp("finished") / "out"


@pytest.mark.parametrize(
    ("changes", "what"),
    [
        ({"machine": {"cores": 9999}}, "the machine of two records differ"),
        ({"software": {"engine": "other"}}, "the software of two records differ: engine"),
        ({"inputs": {"the photograph of x": "0"}}, "the inputs of two records differ"),
        ({"protocol": None}, "does not state this protocol"),
        ({"asked": {}}, "of another configuration than was asked for"),
        ({"end": {}}, "the record is damaged"),
    ],
)
def test_records_that_are_refused(
    folder: Path, finished: Path, changes: dict[str, object], what: str
) -> None:
    twice = "entrants: [tiny.yaml]\nbudgets: [0.001, 500]\nseeds: 1\nrepeats: 2"
    benchmark = described(folder, FILE[FILE.index("entrants") :].rstrip(), twice)
    if not finished.exists():
        run_in_process(benchmark, finished)
    kept = TrialFolder(shutil.copytree(finished, folder / "out"))
    found = read_records(benchmark, kept)
    assert len(found) == 2
    noise = next(table for table in tables(benchmark, found) if "noise" in table.title)
    assert [cell.text for cell in noise.rows[0]] == ["tiny", "0.000", "yes", "-"]
    changed_record(kept, benchmark, **changes)
    with pytest.raises(RunError) as refused:
        read_records(benchmark, kept)
    assert what in str(refused.value)


def test_a_replaced_prior_is_refused(folder: Path) -> None:
    (folder / "tiny.yaml").write_text(
        TINY.replace("{use: random, count: 50}", "consistency_dense")
        + "priors:\n  - use: onnx_mvs\n    name: mvs\n    model: missing.onnx\n    family: mvsanywhere\n"
        "    fallbacks: [{use: plane_sweep}]\n"
    )
    with pytest.raises(ExplainedError, match="another configuration would be trained"):
        described(folder)


@pytest.mark.parametrize(
    ("old", "new", "what"),
    [
        (
            "protocol: {use: llff-3, modified: [scene.test_every, scene.downsample]}\n",
            "",
            "protocol",
        ),
        ("seeds: 1\n", "", "seeds"),
        ("modified: [scene.test_every, scene.downsample]", "modified: []", "but the protocol"),
        ("[tiny.yaml, other.yaml]", "[tiny.yaml, ./tiny.yaml]", "two entrants have one name"),
        ("[tiny.yaml, other.yaml]", "[unknown]", "unknown"),
        ("./fern", "./garden", "no loader of the protocol"),
    ],
)
def test_an_incomplete_benchmark_is_refused(folder: Path, old: str, new: str, what: str) -> None:
    with pytest.raises(ExplainedError) as refused:
        described(folder, old, new)
    assert what in str(refused.value)


def test_ready_programs_are_complete(folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("GSPLAT", "/gsplat")
    names = ", ".join(file.stem for file in sorted(PROGRAMS.glob("*.yaml")))
    benchmark = described(folder, "tiny.yaml, other.yaml", names)
    assert [*benchmark.entrants] == ["brush", "gsplat", "opensplat"]
    for trial in benchmark.trials:
        assert trial.program is not None
        assert trial.program.points == {"use": "sfm", "source": "triangulate"}


def snapshots_of(budgets: list[float], times: list[float]) -> tuple[Snapshots[float], list[float]]:
    """Snapshots of states that are complete at these times, and when states were copied."""
    copies: list[float] = []
    now = [0.0]

    def copy() -> float:
        copies.append(now[0])
        return now[0]

    taken = Snapshots(budgets, copy)
    for now[0] in times:
        taken.complete(now[0])
    return taken, copies


def test_a_state_is_the_last_complete_one() -> None:
    times = [2 + step / 256 for step in range(769)]
    taken, copies = snapshots_of([1.0, 3.0, 4.0, 9.0], times)
    # The initial state came too late for the first budget; training ended before the last one.
    assert taken.kept == {3.0: (3.0, 3.0), 4.0: (4.0, 4.0)}
    assert taken.seconds == 5.0
    assert len(copies) < len(times) / 5


def test_an_iteration_that_suddenly_takes_longer_leaves_a_state_that_is_almost_as_new() -> None:
    times = [2 + step / 256 for step in range(500)]
    last = times[-1]
    taken, _ = snapshots_of([4.0], [*times, last + 0.5])
    assert last < 4.0
    assert last - 0.01 * 4.0 <= taken.kept[4.0].seconds <= last


def test_equal_bits_are_unknown_without_hashes(folder: Path) -> None:
    """Another program that renders by itself leaves no Gaussians to compare."""
    benchmark = described(folder, "repeats: 1", "repeats: 2")
    for hashes, shown in ((["a", "a"], "yes"), (["a", "b"], "no"), ([None, None], "-")):
        records = {
            trial: {
                "end": {"test": {"psnr": 20.0}, "seconds": 1.0, "unavailable": {}},
                "budgets": {},
                "hash": hashes[trial.repeat],
            }
            for trial in benchmark.trials
        }
        (noise,) = (t for t in tables(benchmark, records) if t.title.startswith("noise"))
        assert [row[2].text for row in noise.rows] == [shown, shown]
