"""A hundred mistakes in a shipped pipeline: each refused at once, with its line and what to do."""

from __future__ import annotations

import re
import sys
import time
from collections.abc import Iterator
from itertools import zip_longest
from pathlib import Path

import pytest

from core_rasterizer import ExplainedError
from registry.pipeline.pipeline import load_pipeline
from tests.fuzzing.formats.texts import ENVIRONMENT, shipped_plugins
from tests.host import Plugins

SHIPPED = Path(__file__).parents[3] / "pipelines" / "stereogs.yaml"
SLOWEST = 1.0
"""Seconds, for the answer to one mistake."""

MISSPELT = (
    *("scene", "priors", "initializer", "regularizers", "densification", "opacity", "metrics"),
    *("exporters", "training", "path", "train_views", "family", "model", "prior", "weight"),
    *("start", "refresh_threshold", "every", "size_prune_from", "base", "sensitivity"),
    *("iterations", "sh_degree", "checkpoint_every", "use", "name"),
)
"""Keys of which two letters change places."""
NAMES = {
    "llff": "lllff",
    "onnx_mvs": "onnx_msv",
    "mvsanywhere": "mvs_anywhere",
    "onnx_stereo": "onnxstereo",
    "foundation_stereo": "FoundationStereo",
    "consistency_dense": "consistency-dense",
    "stereo_depth": "stereo_deth",
    "gradient_threshold": "gradient",
    "gradient_aware_decay": "gradient_aware_deacy",
}
"""Names of components and families, and what somebody may write for them."""
TRAINING = "training:\n  iterations: 30000\n  sh_degree: 1\n  checkpoint_every: 5000\n"
OPACITY = "opacity:\n  use: gradient_aware_decay\n  base: 0.99\n  sensitivity: 0.5\n  start: 1001\n"
INITIALIZER = "initializer:\n  use: consistency_dense\n  prior: multi_view\n"
WRONG: tuple[tuple[str, str], ...] = (
    # numbers
    ("train_views: 3", "train_views: three"),
    ("train_views: 3", "train_views: 3.5"),
    ("train_views: 3", "train_views: -3"),
    ("train_views: 3", "train_views: '3'"),
    ("train_views: 3", "train_views: [3]"),
    ("train_views: 3", "train_views: {views: 3}"),
    ("train_views: 3", "train_views: true"),
    ("train_views: 3", "train_views: .nan"),
    ("train_views: 3", "train_views: 99999999999999999999999"),
    ("train_views: 3", "train_views: 3\n  downsample: 0"),
    ("weight: 1", "weight: -1"),
    ("weight: 1", "weight: .inf"),
    ("weight: 1", "weight: one"),
    ("weight: 1", "weight: 1,5"),
    ("base: 0.99", "base: 1.01"),
    ("base: 0.99", "base: -0.99"),
    ("base: 0.99", "base: 99%"),
    ("base: 0.99", "base: null"),
    ("sensitivity: 0.5", "sensitivity: -1"),
    ("sh_degree: 1", "sh_degree: 4"),
    ("sh_degree: 1", "sh_degree: -1"),
    ("sh_degree: 1", "sh_degree: 1.0"),
    ("iterations: 30000", "iterations: 0"),
    ("iterations: 30000", "iterations: 30.000,0"),
    ("iterations: 30000", "iterations: 3e4"),
    ("iterations: 30000", "iterations: 30_000"),
    ("checkpoint_every: 5000", "checkpoint_every: -1"),
    ("checkpoint_every: 5000", "checkpoint_every: often"),
    ("checkpoint_every: 5000", "seed: -1"),
    ("checkpoint_every: 5000", "seed: random"),
    # schedules
    ("start: 20001", "start: 150%"),
    ("start: 20001", "start: -5%"),
    ("start: 20001", "start: 0"),
    ("start: 20001", "start: 20001.5"),
    ("start: 20001", "start: half"),
    ("every: 100", "every: 0"),
    ("every: 100", "every: -100"),
    ("every: 100", "every: 101%"),
    ("every: 100", "stop: 150%"),
    ("start: 1001", "stop: 0"),
    # structure
    ("metrics: [psnr, ssim, lpips]", "metrics: psnr"),
    ("metrics: [psnr, ssim, lpips]", "metrics: [psnr, psnr]"),
    ("metrics: [psnr, ssim, lpips]", "metrics: [psnr, 3]"),
    ("metrics: [psnr, ssim, lpips]", "metrics: [[psnr]]"),
    ("metrics: [psnr, ssim, lpips]", "metrics: {use: psnr}"),
    ("exporters: [ply]", "exporters: true"),
    ("exporters: [ply]", "exporters: [ply]\nexporters: []"),
    ("exporters: [ply]", "exporters: [{name: ply}]"),
    (TRAINING, "training: fast\n"),
    (TRAINING, "training: [1]\n"),
    (OPACITY, "opacity: 3\n"),
    (OPACITY, "opacity: [constant_decay, 3]\n"),
    (INITIALIZER, "initializer: [random]\n"),
    ("  prior: multi_view", "  prior: 3"),
    ("name: stereogs", "name: 3"),
    ("name: stereogs", "name: ''"),
    ("name: stereogs", "name: [stereogs]"),
    ("name: stereogs", "protocol: lff-3\nname: stereogs"),
    ("name: stereogs", "protocol: 3\nname: stereogs"),
    ("    name: multi_view", "    name: multi view"),
    ("    name: stereo", "    name: ../../evil"),
    ("    name: stereo", "    name: multi_view"),
    ("    family: mvsanywhere", "    provider: quantum"),
    ("    family: mvsanywhere", "    sha256: 0123"),
    # variables
    ("path: ${STEREOGS_DATA}/llff_fern", 'path: "${STEREOGS_DATA"'),
    ("path: ${STEREOGS_DATA}/llff_fern", "path: ${STEREOGS_DTA}/llff_fern"),
    ("path: ${STEREOGS_DATA}/llff_fern", "path: ${}/llff_fern"),
    ("path: ${STEREOGS_DATA}/llff_fern", "path: 3"),
    # YAML itself
    ("metrics: [psnr, ssim, lpips]", "metrics: [psnr, ssim, lpips"),
    ("exporters: [ply]", "exporters: {use: ply"),
    ("name: stereogs", 'name: "stereogs'),
    ("exporters: [ply]", "exporters: ply]"),
    ("exporters: [ply]", "\texporters: [ply]"),
    ("  base: 0.99", "\tbase: 0.99"),
    ("  base: 0.99", "   base: 0.99"),
    ("  base: 0.99", "  base 0.99"),
    ("  base: 0.99", "  base: 0.99: 1"),
    ("  base: 0.99", "  base: &anchor 0.99\n  sensitivity: *anchor\n  x:"),
    ("  base: 0.99", "  base: !!python/object/apply:os.system [true]"),
    ("  base: 0.99", "  base: !!float 0.99"),
    ("  base: 0.99", "  ? [base]\n  : 0.99"),
    ("  base: 0.99", "  <<: {base: 0.99}"),
    ("  base: 0.99", "  base: 0.99\n  base: 0.98"),
    ("  base: 0.99", "  base: \x01"),
    ("  base: 0.99", "  base: \x1b[31m"),
    ("  base: 0.99", '  base: "\\q"'),
    ("  base: 0.99", '  base: "\\ud800"'),
    ("  base: 0.99", "  base: " + "[" * 40 + "]" * 40),
    ("  base: 0.99", "  base: " + "[" * 5000),
    ("  base: 0.99", "  base: @home"),
    ("  base: 0.99", "  base: `0.99`"),
    ("  base: 0.99", "  base: %"),
    ("name: stereogs", "name: stereogs\n---\nname: other"),
)
"""What stands in the file, and what somebody wrote instead."""


def _swapped(key: str) -> str:
    middle = len(key) // 2
    return key[: middle - 1] + key[middle] + key[middle - 1] + key[middle + 1 :]


def damaged() -> dict[str, tuple[str, int]]:
    """Each mistake as the whole text, and the line where it begins."""
    text = SHIPPED.read_text("utf-8")
    changes = [(f"{key}:", f"{_swapped(key)}:") for key in MISSPELT]
    changes += [(f" {name}\n", f" {wrong}\n") for name, wrong in NAMES.items()]
    found = {}
    for old, new in (*changes, *WRONG):
        match = re.search(rf"(?<![a-z_])(?<!# ){re.escape(old)}", text)
        assert match is not None, f"{old} is not in {SHIPPED.name}"
        letters = enumerate(zip_longest(old, new))
        alike = next(place for place, (one, other) in letters if one != other)
        alike += new.startswith(f"{old}\n")  # what is added begins in the next line
        changed = text[: match.start()] + new + text[match.end() :]
        line = changed[: match.start() + alike].count("\n") + 1
        found[f"{old.strip()} -> {new.strip()[:40]!r}"] = (changed, line)
    return found


DAMAGED = damaged()


@pytest.fixture(scope="module")
def plugins() -> Plugins:
    """Those that ship; all are imported, as the first wrong name would."""
    found = shipped_plugins()
    found.all()
    return found


def test_there_are_more_than_a_hundred() -> None:
    assert len(DAMAGED) > 100


@pytest.fixture
def untraced() -> Iterator[None]:
    """The time without that of measuring coverage, which is longer."""
    trace = sys.gettrace()
    sys.settrace(None)
    yield
    sys.settrace(trace)


@pytest.mark.usefixtures("untraced")
@pytest.mark.parametrize(("text", "line"), DAMAGED.values(), ids=list(DAMAGED))
def test_each_is_refused_with_its_line_and_a_suggestion(
    text: str, line: int, plugins: Plugins, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    for name, value in ENVIRONMENT.items():
        monkeypatch.setenv(name, value)
    path = tmp_path / "pipeline.yaml"
    path.write_text(text, "utf-8")
    start = time.process_time()
    with pytest.raises(ExplainedError) as caught:
        load_pipeline(path, plugins)
    assert time.process_time() - start < SLOWEST
    error = caught.value
    assert error.where.split(";")[0].split(" ")[0] == f"{path}:{line}"
    assert error.fix or "did you mean" in error.what
