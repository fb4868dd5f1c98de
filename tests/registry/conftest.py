"""Fixtures: no plugin is installed, unless a test installs it."""

from __future__ import annotations

import sys
from collections.abc import Callable, Iterator
from importlib.metadata import EntryPoint
from pathlib import Path

import fsspec
import pytest

from core_rasterizer import Device, open_device
from tests.host import GROUP, SELECTION, Plugins

TOY_NAMES = (
    *("toy_scene", "toy_points", "toy_prior", "toy_term", "toy_dropout", "toy_growth", "toy_fade"),
    *("toys.psnr", "toy_files", "toy_report", "toy_diary"),
)
TOY_ENTRIES = dict.fromkeys(TOY_NAMES, "tests.registry.toy_plugin")
TOYS = [EntryPoint(name, module, GROUP) for name, module in TOY_ENTRIES.items()]
EXTENSION_NAMES = (
    *(
        "toy_target",
        "toy_pose",
        "toy_exposure",
        "toy_noise",
        "toy_shape",
        "toy_picture",
        "toy_twin",
    ),
    *("toy_guide", "toy_peek", "toy_guided", "toy_move"),
)
EXTENSION_POINTS = [
    EntryPoint(name, "tests.registry.toy_extension_points", GROUP) for name in EXTENSION_NAMES
]

Install = Callable[..., Path]


@pytest.fixture(autouse=True)
def _no_installed_plugins(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv(SELECTION, "")


@pytest.fixture
def toys() -> Plugins:
    """Return the toy components."""
    return Plugins(TOYS)


@pytest.fixture
def extension_points() -> Plugins:
    """Return the toy components and those that use every extension point of the host."""
    return Plugins([*TOYS, *EXTENSION_POINTS])


@pytest.fixture(scope="session")
def device() -> Device:
    """Return the default device."""
    return open_device()


@pytest.fixture
def install(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[Install]:
    """Install packages for one test: real modules with real entry-point metadata.

    `install("acme", "1.2", {"entry": "module"}, module="source text")`
    """
    chosen: list[str] = []
    written: list[str] = []

    def install(package: str, version: str, entries: dict[str, str], **modules: str) -> Path:
        site = tmp_path / f"site-{package}"
        metadata = site / f"{package}-{version}.dist-info"
        metadata.mkdir(parents=True)
        (metadata / "METADATA").write_text(
            f"Metadata-Version: 2.1\nName: {package}\nVersion: {version}\n"
        )
        lines = [f"{name} = {module}" for name, module in entries.items()]
        (metadata / "entry_points.txt").write_text("\n".join([f"[{GROUP}]", *lines, ""]))
        for name, source in modules.items():
            (site / f"{name}.py").write_text(source)
        monkeypatch.syspath_prepend(site)
        written.extend(modules)
        chosen.extend(entries)
        monkeypatch.setenv(SELECTION, ",".join(chosen))
        return site

    yield install
    for name in written:
        sys.modules.pop(name, None)


@pytest.fixture(params=["memory", "s3"])
def remote_root(request: pytest.FixtureRequest, monkeypatch: pytest.MonkeyPatch) -> Iterator[str]:
    """The URL of an empty folder."""
    if request.param == "memory":
        yield "memory://bucket"
        fsspec.filesystem("memory").rm("/bucket", recursive=True)
        return
    pytest.importorskip("s3fs")
    server = pytest.importorskip("moto.server").ThreadedMotoServer(port=0)
    server.start()
    address, port = server.get_host_and_port()
    monkeypatch.setenv("AWS_ENDPOINT_URL", f"http://{address}:{port}")
    monkeypatch.setenv("AWS_MAX_ATTEMPTS", "1")
    for name in ("AWS_ACCESS_KEY_ID", "AWS_SECRET_ACCESS_KEY"):
        monkeypatch.setenv(name, "given")
    system = fsspec.filesystem("s3", skip_instance_cache=True)
    system.mkdir("bucket")
    system.clear_instance_cache()
    yield "s3://bucket"
    fsspec.filesystem("s3").rm("bucket", recursive=True)
    system.clear_instance_cache()
    server.stop()
