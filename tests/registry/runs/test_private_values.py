"""Values of `${NAME}` in a pipeline may be secret: no file of a run has them; `resume` reads them again."""

from __future__ import annotations

from pathlib import Path

import pytest

from core_rasterizer import Device
from tests.host import PipelineError, Plugins, without_credentials
from tests.registry.runs.toy_run import resumed, run
from tests.registry.toy_plugin import ToySceneSettings

SECRET = "s3cret-f0lder"


@pytest.fixture
def trained(toys: Plugins, device: Device, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.setenv("PRIVATE", SECRET)
    folder, finished, _ = run(toys, device, tmp_path / "run", "scene.path=${PRIVATE}/$${x}")
    assert finished
    return folder.path


def files_with(text: str, folder: Path) -> list[str]:
    files = [path for path in folder.rglob("*") if path.is_file()]
    return [path.name for path in files if text.encode() in path.read_bytes()]


def test_no_file_of_a_run_has_the_value(trained: Path) -> None:
    assert files_with(SECRET, trained) == []
    assert "path: ${PRIVATE}/$${x}" in (trained / "pipeline.yaml").read_text("utf-8")


def test_a_resumed_run_reads_it_again(
    trained: Path, toys: Plugins, device: Device, monkeypatch: pytest.MonkeyPatch
) -> None:
    item = resumed(trained, toys, device).pipeline.one("scene")
    assert item.settings.model_dump(mode="json")["path"] == f"{SECRET}/${{x}}"
    monkeypatch.delenv("PRIVATE")
    with pytest.raises(PipelineError, match="the environment variable 'PRIVATE' is not set"):
        resumed(trained, toys, device)


@pytest.mark.parametrize("name", ["STEREOGS_PLACE", "PLACE"])
def test_variables_of_ours_and_public_settings_are_recorded(
    name: str, toys: Plugins, device: Device, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv(name, "anywhere")
    if not name.startswith("STEREOGS_"):
        monkeypatch.setattr(ToySceneSettings, "public", ("path",))
    folder, *_ = run(toys, device, tmp_path / "run", f"scene.path=${{{name}}}")
    assert "path: anywhere" in folder.pipeline.read_text("utf-8")


def test_passwords_in_urls_are_not_shown() -> None:
    text = "tracking_uri: 'http://me:pass@host:5000/x'\nother: http://host/a@b"
    assert without_credentials(text).splitlines() == [
        "tracking_uri: 'http://***@host:5000/x'",
        "other: http://host/a@b",
    ]
