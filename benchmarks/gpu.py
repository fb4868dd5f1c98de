"""Times of a GPU: kernels of the engine and of gsplat, host time, whole trainings, tests: `make gpu`.

Takes at most eight minutes on a card, without a network. Without a GPU it runs on the CPU at tiny sizes.
Prints the tables and writes `benchmarks/out/gpu.json`; with `--write-docs` that becomes the record, and the
tables in `docs/run_time.md` are rewritten. `--from FILE` takes such a file of another machine. A part that
fails is left out of the tables; the record says why.
"""

from __future__ import annotations

import argparse
import json
import os
import platform
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Collection, Iterator, Mapping, Sequence
from dataclasses import asdict, dataclass
from functools import partial
from pathlib import Path
from typing import Any

import pyopencl as cl
import torch

from benchmarks import pages
from benchmarks.engine import Workload, stages
from benchmarks.host_time import engine_host_ms, pipeline_host_ms
from benchmarks.peer import cuda_times
from benchmarks.records import RECORDS
from benchmarks.trainings import PIPELINES
from benchmarks.yardsticks import milliseconds, python_milliseconds
from core_rasterizer import Device, open_device
from core_rasterizer.errors import ExplainedError
from core_rasterizer.self_test import self_test
from registry.system.files import write_json
from stereogs.experiments.showing.score_table import markdown
from stereogs.session import build_pipeline

TARGET = "gpu"
OUT, RECORD = Path(__file__).parent / "out" / "gpu.json", RECORDS / "gpu.json"
PAGE, ROOT = pages.DOCS / "run_time.md", pages.DOCS.parent
NEEDLES = ("tests/core_rasterizer/test_stress_shapes.py", "-k", "needle or cancels")
STEPS = {
    "project": "project",
    "raster": "raster",
    "photometric": "loss",
    "dissimilarity": "loss",
    "gradient": "loss",
    "save_pixel_states": "raster, backward",
    "raster_backward": "raster, backward",
    "project_backward": "project, backward, and Adam",
    "adam": "project, backward, and Adam",
    "project_backward_and_step": "project, backward, and Adam",
}
"""Row of the table for each kernel; other kernels make tile lists."""
SUMMARY = ("kernels but loss", "gsplat: kernels", "wall", "gsplat: wall", "host")
"""Rows in the docs."""


@dataclass(frozen=True)
class Sizes:
    """What is measured.

    Args:
        scenes: Numbers of Gaussians with width and height of the image.
        pipelines: Names of pipelines with overrides; for host time also those of the second tuple.
        for_host: Overrides for host time.
        repeats: Iterations per figure.
    """

    scenes: tuple[tuple[int, int, int], ...]
    pipelines: Mapping[str, tuple[str, ...]]
    for_host: tuple[str, ...]
    repeats: int


CARD = Sizes(
    ((10_000, 504, 378), (126_000, 504, 378), (1_000_000, 1920, 1080), (3_000_000, 1920, 1080)),
    {
        "weightfree_fast": (),
        "stereogs_short": ("metrics=[psnr, ssim]",),
        "3dgs_fast": (),
    },
    ("training.iterations=300",),
    repeats=20,
)
TINY = Sizes(
    ((500, 64, 48),),
    {
        "demo": (
            "scene={use: procedural, width: 48, height: 36}",
            "training.iterations=8",
            "reports=[]",
        )
    },
    (),
    repeats=2,
)


def measure(device: Device, sizes: Sizes, file: Path) -> dict[str, Any]:
    """Return all figures as plain JSON values, also written to a file after each part.

    A part that fails is a text with the error.
    """
    record: dict[str, Any] = {
        "card": device.name,
        "driver": f"{device.platform}, {device.driver}",
        "kind": device.kind,
        "machine": f"{os.cpu_count()} threads, {_processor()}",
        "versions": {"torch": torch.__version__, "pyopencl": cl.VERSION_TEXT},
        "python_ms": python_milliseconds(),
    }
    for section, key, work in _parts(device, sizes):
        try:
            found: Any = work()
        except ExplainedError as error:
            found = error.what
        except subprocess.CalledProcessError as error:
            found = str(error.stderr).strip()[-500:]
        except Exception as error:  # a peer or a driver may raise anything
            found = f"{type(error).__name__}: {error}"[:500]
        record.setdefault(section, {})[key] = found
        write_json(file, record)
    return record


def _parts(device: Device, sizes: Sizes) -> Iterator[tuple[str, str, Callable[[], Any]]]:
    """Yield section, name and measurement of each part; the longest are last."""
    yield "tests", "self-test", lambda: asdict(self_test(device))
    for count, *size in sizes.scenes:
        yield "engine", str(count), partial(engine, count, size, device, sizes.repeats)
    yield "tests", "needles", partial(_needles, device)
    for count, *size in sizes.scenes:
        yield "gsplat", str(count), partial(cuda_times, count, size, sizes.repeats)
    for name, overrides in sizes.pipelines.items():
        yield "host", name, partial(_host, name, (*overrides, *sizes.for_host), device)
        yield "trainings", name, partial(trained, name, overrides, device)


def engine(count: int, size: Sequence[int], device: Device, repeats: int) -> dict[str, Any]:
    """Return milliseconds of kernels, of an iteration with a wait at its end ("wall"), and of the host."""
    width, height = size
    kernels = stages(count, device, repeats, size=(width, height))
    workload = Workload(count, device, width, height)
    return {
        "size": [width, height],
        "kernels": kernels,
        "wall": milliseconds(workload.iteration, repeats),
        "host": engine_host_ms(workload, repeats),
    }


def trained(name: str, overrides: Sequence[str], device: Device) -> dict[str, Any]:
    """Train a pipeline by the command line; return seconds of the command and parts of its results."""
    with tempfile.TemporaryDirectory() as folder:
        out = Path(folder) / "run"
        settings = [word for override in overrides for word in ("--set", override)]
        command = [sys.executable, "-m", "stereogs", "train", str(PIPELINES / f"{name}.yaml")]
        command += [*settings, "--device", device.name, "--out", str(out)]
        begin = time.monotonic()
        subprocess.run(command, cwd=ROOT, check=True, capture_output=True, text=True)
        seconds = time.monotonic() - begin
        results = json.loads((out / "results.json").read_text("utf-8"))
    kept = ("seconds", "seconds_total", "stages", "test", "gaussians", "iterations", "hash")
    return {"command": seconds} | {key: results[key] for key in kept}


def _host(name: str, overrides: Sequence[str], device: Device) -> float:
    return pipeline_host_ms(build_pipeline(PIPELINES / f"{name}.yaml", overrides), device)


def _needles(device: Device) -> list[str]:
    """Run the tests of long, thin Gaussians in a process of their own; return failures and the summary."""
    command = [sys.executable, "-m", "pytest", "-n", "0", "--tb=line", "-o", "addopts=", *NEEDLES]
    environment = {**os.environ, "STEREOGS_DEVICE": device.name}
    result = subprocess.run(
        command, cwd=ROOT, env=environment, capture_output=True, text=True, check=False
    )
    lines = (result.stdout or result.stderr).splitlines()
    failed = [line.removeprefix(f"{ROOT}/") for line in lines if line.startswith(str(ROOT))]
    return failed + lines[-1:]


def _processor() -> str:
    file = Path("/proc/cpuinfo")
    lines = file.read_text("utf-8").splitlines() if file.is_file() else []
    names = [line.partition(": ")[2] for line in lines if line.startswith("model name")]
    return names[0] if names else platform.machine()


def tables(record: Mapping[str, Any], shown: Collection[str] | None = None) -> str:
    """Return the figures of a card as Markdown; gsplat's only if it ran at all sizes.

    Args:
        shown: Rows of the first table; None: all.
    """
    engine, peer, trained = (
        {key: row for key, row in record[section].items() if isinstance(row, dict)}
        for section in ("engine", "gsplat", "trainings")
    )
    rows = _engine_rows(
        [*engine.values()], [*peer.values()] if peer.keys() == engine.keys() else []
    )
    head = ["milliseconds", *(f"{int(count):,}" for count in engine)]
    runs = [
        [
            f"`{name}`",
            f"{row['seconds']:.1f}",
            f"{row['seconds_total']:.1f}",
            f"{row['command']:.1f}",
            f"{row['test']['psnr']:.2f}",
            f"{host:.2f} ({host / record['python_ms']:.2f})",
        ]
        for name, row in trained.items()
        if isinstance(host := record["host"].get(name), float)
    ]
    columns = ["pipeline", "training, s", "total, s", "command, s", "PSNR", "host"]
    title = f"{record['card']} ({record['driver']}); {record['machine']}.\n"
    chosen = [row for row in rows if shown is None or row[0] in shown]
    return "\n".join([title, markdown(head, chosen), markdown(columns, runs)])


def _engine_rows(
    engine: Sequence[Mapping[str, Any]], peer: Sequence[Mapping[str, float]]
) -> list[list[str]]:
    """Rows with a cell for each size."""
    rows = [["image", *("x".join(map(str, one["size"])) for one in engine)]]
    made = [_steps(one["kernels"]) for one in engine]
    for name in dict.fromkeys(key for steps in made for key in steps):
        rows.append([name, *(f"{steps.get(name, 0):.2f}" for steps in made)])
    rows.append(["kernels but loss", *(_sum(steps, without="loss") for steps in made)])
    if peer:
        for key in ("forward", "backward", "Adam"):
            rows.append([f"gsplat: {key}", *(f"{one[key]:.2f}" for one in peer)])
        rows.append(["gsplat: kernels", *(_sum(one, without="wall") for one in peer)])
        rows.append(["gsplat: wall", *(f"{one['wall']:.2f}" for one in peer)])
    for name in ("wall", "host"):
        rows.append([name, *(f"{one[name]:.2f}" for one in engine)])
    return rows


def _sum(row: Mapping[str, float], without: str) -> str:
    return f"{sum(value for key, value in row.items() if key != without):.2f}"


def _steps(kernels: Mapping[str, float]) -> dict[str, float]:
    """Sums of kernels by `STEPS`, in the order in which they first run."""
    sums: dict[str, float] = {}
    for kernel, time_ms in kernels.items():
        step = STEPS.get(kernel, "tile lists")
        sums[step] = sums.get(step, 0.0) + time_ms
    return sums


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--device", help="part of a device's name")
    parser.add_argument("--from", dest="file", type=Path, help="a file written by another machine")
    parser.add_argument("--write-docs", action="store_true", help="rewrite the record and tables")
    arguments = parser.parse_args()
    torch.set_num_threads(1)  # as `stereogs` does, next to the OpenCL device's threads
    if arguments.file:
        record = json.loads(arguments.file.read_text("utf-8"))
    else:
        device = open_device(arguments.device)
        OUT.parent.mkdir(parents=True, exist_ok=True)
        record = measure(device, CARD if device.kind == "gpu" else TINY, OUT)
    print(tables(record))
    if arguments.write_docs and record["kind"] != "gpu":
        print("the docs are unchanged: they show GPUs")
    elif arguments.write_docs:
        write_json(RECORD, record)
        pages.write_tables("gpu", "The engine on a GPU", TARGET, tables(record))
        pages.rewrite(PAGE, pages.marks(TARGET), tables(record, SUMMARY))
    return 0


if __name__ == "__main__":
    sys.exit(main())
