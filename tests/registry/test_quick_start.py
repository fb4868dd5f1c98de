"""Commands that compute nothing do not import slow libraries."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[2]
SLOW = ("torch", "pyopencl", "pycolmap", "onnxruntime", "scipy", "skimage", "numpy")
SCRIPT = """
import contextlib, io, os, sys
os.environ.pop("STEREOGS_PLUGINS", None)
from stereogs.cli import main
answers = []
for arguments in {lines!r}:
    said = io.StringIO()
    with contextlib.redirect_stdout(said), contextlib.redirect_stderr(said):
        try:
            status = main(arguments)
        except SystemExit as stop:
            status = stop.code
    loaded = [name for name in {slow!r} if name in sys.modules]
    answers.append((status, said.getvalue(), loaded))
print(repr(answers))
"""
TEXT = """\
name: refused
scene: {use: procedural}
initializer: sfm
regularizers: [{use: stereo_depth, tau: 2}]
priors: [sgm, plane_sweep]
metrics: [psnr, ssim, lpips]
"""
REFUSED = {
    "metrics=[psmr]": "did you mean 'psnr'",
    "scene.widht=3": "did you mean 'width'",
    "scene.width=wide": "must be a whole number",
    "scene.width=1": "greater than or equal to 16",
    "regularizers.stereo_depth.tau=-1": "tau",
    "priors.plane_sweep.large_penalty=1": "at least `small_penalty`",
    "metric=[psnr]": "did you mean 'metrics'",
    "training.iteration=3": "did you mean 'iterations'",
    "training.iterations": "must look like a.b=value",
    "protocol=llff-4": "unknown protocol",
}


def answers(lines: list[list[str]], folder: Path) -> list[tuple[int, str, list[str]]]:
    """Return the exit status, output and loaded slow libraries after each command line."""
    output = subprocess.run(
        [sys.executable, "-c", SCRIPT.format(lines=lines, slow=SLOW)],
        cwd=folder,
        env={"PYTHONPATH": str(ROOT), "PATH": "/usr/bin:/bin", "HOME": str(folder)},
        capture_output=True,
        text=True,
        check=True,
    ).stdout
    found: list[tuple[int, str, list[str]]] = eval(output)
    return found


def test_help_version_listing_and_usage_errors_import_nothing_slow(tmp_path: Path) -> None:
    lines = [[], ["--help"], ["--version"], ["trian"], ["train", "--help"], ["plugins"]]
    bare, help_, version, mistyped, verb_help, listed = answers(lines, tmp_path)
    assert bare == (0, help_[1], [])
    assert version[1].startswith("stereogs 0.")
    assert mistyped[0] == 2
    assert "did you mean 'train'?" in mistyped[1]
    assert "--disable" in verb_help[1]
    assert "stereo_depth" in listed[1]
    assert [answer[2] for answer in (bare, help_, version, mistyped, verb_help, listed)] == [[]] * 6


def test_invalid_pipelines_import_nothing_slow(tmp_path: Path) -> None:
    file, broken = tmp_path / "refused.yaml", tmp_path / "broken.yaml"
    file.write_text(TEXT)
    broken.write_text("name: [")
    lines = [["train", str(file), "--set", change] for change in REFUSED]
    lines += [
        ["train", str(broken)],
        ["train", str(tmp_path / "none.yaml")],
        ["resume", str(tmp_path)],
        ["eval", str(tmp_path)],
        ["compare", str(tmp_path)],
        ["check", str(tmp_path / "none")],
        ["ablate", str(file), "--toggle", "nothing"],
    ]
    expected = [
        *REFUSED.values(),
        "not valid YAML",
        "cannot be read",
        "not a run folder",
        "not a run folder",
        "not a run folder",
        "no such folder",
        "nothing",
    ]
    for line, said, (status, output, loaded) in zip(
        lines, expected, answers(lines, tmp_path), strict=True
    ):
        assert (status, loaded) == (2, []), f"{line}: {output}"
        assert said in output


@pytest.mark.parametrize("module", ["stereogs"])
def test_modules_run_the_command(module: str) -> None:
    output = subprocess.run(
        [sys.executable, "-m", module, "--version"],
        cwd=ROOT,
        capture_output=True,
        text=True,
        check=True,
    ).stdout
    assert output.startswith("stereogs 0.")


HASHES = """
import sys
sys.settrace(eval(sys.argv.pop()))
from stereogs.__main__ import main
main()
print(hash("a word"))
"""


def hashes(*given: str, seed: str | None = None, trace: str = "None") -> set[str]:
    """Hashes of a text in two processes that run the command line."""
    known = {k: v for k, v in os.environ.items() if k != "PYTHONHASHSEED"}
    command = [sys.executable, "-c", HASHES, *given, trace]
    env = known if seed is None else {**known, "PYTHONHASHSEED": seed}
    runs = (
        subprocess.run(command, cwd=ROOT, env=env, capture_output=True, text=True, check=True)
        for _ in range(2)
    )
    return {done.stdout.splitlines()[-1] for done in runs}


def test_verbs_hash_texts_alike_in_every_process() -> None:
    fixed = hashes("no-verb")
    assert len(fixed) == 1
    assert fixed == hashes("no-verb", seed="0") != hashes("no-verb", seed="7")


def test_help_and_debuggers_do_not_start_again() -> None:
    assert len(hashes("--version")) == 2
    assert len(hashes("no-verb", "--help")) == 2
    assert len(hashes("no-verb", trace="lambda *_: None")) == 2
