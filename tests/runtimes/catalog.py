"""The runtimes, and the environment that selects each."""

from __future__ import annotations

import os
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

from core_rasterizer.device import Variant
from tests.core_rasterizer.quick_device import OPTIMIZE
from tests.runtimes.fetching import ROOT, unpacked

LIBRARIES = Path("usr", "lib", "x86_64-linux-gnu")


@dataclass(frozen=True)
class Runtime:
    """An OpenCL implementation.

    Args:
        name: for the command line and the table.
        stands_for: the class of devices that it is tested in place of.
        device: selects it, as in STEREOGS_DEVICE.
        fetch: unpacks it, if necessary, and returns environment variables.
        variants: of the kernels that are tested.
    """

    name: str
    stands_for: str
    device: str
    fetch: Callable[[], dict[str, str]]
    variants: tuple[Variant, ...] = ("cpu", "gpu")

    def environment(self) -> dict[str, str]:
        """Environment of a process that uses this runtime.

        Raises:
            Unavailable: it cannot be fetched.
        """
        return {**os.environ, OPTIMIZE: "1", "STEREOGS_DEVICE": self.device, **self.fetch()}


def selected(folder: Path, library: Path, libraries: Path) -> dict[str, str]:
    """Variables that make an OpenCL loader use a library of an unpacked runtime."""
    vendors = folder / "vendors"
    vendors.mkdir(exist_ok=True)
    (vendors / "runtime.icd").write_text(f"{folder / library}\n", "utf-8")
    return {"OCL_ICD_VENDORS": str(vendors), "LD_LIBRARY_PATH": str(folder / libraries)}


def _installed() -> dict[str, str]:
    return {}


def _debian_pocl() -> dict[str, str]:
    folder = unpacked("pocl", debian=("pocl-opencl-icd",))
    return selected(folder, LIBRARIES / "libpocl.so.2", LIBRARIES)


def _intel() -> dict[str, str]:
    versions = {
        "intel-opencl-rt": "2026.2.0",
        "intel-cmplr-lib-rt": "2026.2.0",
        "tbb": "2023.2.0",
        "tcmlib": "1.6.0",
        "umf": "1.2.0",
    }
    folder = unpacked("intel", wheels=[f"{name}=={number}" for name, number in versions.items()])
    return selected(folder, Path("lib", "libintelocl.so"), Path("lib"))


def _rusticl() -> dict[str, str]:
    """Mesa names folders of the system for two things: the headers of its compiler, which a build option can
    name too, and its library of built-in functions, for which its copy here gets a path of equal length below
    the folder that the process starts in."""
    folder = unpacked("mesa", debian=("mesa-opencl-icd",))
    built_ins = ROOT / "build" / "libclc"
    if not built_ins.exists():
        library = folder / LIBRARIES / "libRusticlOpenCL.so.1"
        library.write_bytes(library.read_bytes().replace(b"/usr/lib/clc/", b"build/libclc/"))
        built_ins.symlink_to(folder / "usr" / "lib" / "clc")
    (headers,) = folder.glob("usr/lib/llvm-*/lib/clang/*/include")
    return {
        **selected(folder, LIBRARIES / "libRusticlOpenCL.so.1", LIBRARIES),
        "RUSTICL_ENABLE": "llvmpipe",
        "PYOPENCL_BUILD_OPTIONS": f"-I {headers}",
    }


RUNTIMES = (
    Runtime("PoCL from pip", "CPU", "3.0-rc2", _installed),
    Runtime("PoCL from Debian", "CPU, newer compiler", "+debian", _debian_pocl),
    Runtime("Intel CPU runtime", "CPU, another compiler", "Intel(R) OpenCL", _intel),
    # A stand-in for GPUs: llvmpipe compiles the kernels of CPUs too, which takes hours of tests.
    Runtime("Mesa rusticl", "GPU without double precision", "rusticl", _rusticl, ("gpu",)),
)
