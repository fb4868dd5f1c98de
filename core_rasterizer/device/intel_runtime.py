"""Tells OpenCL loaders of Intel's runtime for CPUs if pip installed it.

A loader finds drivers in /etc/OpenCL/vendors, in the registry of Windows, or by an environment variable.
pip can write to neither of the first two, so this sets the variable, unless the user did. Child processes
inherit it.
"""

from __future__ import annotations

import os
import shutil
import sys
from importlib.metadata import PackageNotFoundError, files
from pathlib import Path

from .temporary import folder_until_exit

INTEL = "pip install 'stereogs-rasterizer[intel]'"
"""Command that installs the runtime."""
_VENDORS = "OCL_ICD_VENDORS"
"""Environment variable: a folder of .icd files, which name drivers' libraries, instead of the system's."""
_LIBRARIES = "OCL_ICD_FILENAMES"
"""Environment variable of Khronos's loader: further drivers' libraries."""
_SYSTEM = Path("/etc/OpenCL/vendors")
_NAMES = ("libintelocl.so", "intelocl64.dll")


def offer_intel_runtime() -> None:
    """Set the variable if the runtime is installed; to be called before the first use of OpenCL."""
    on_windows = sys.platform == "win32"
    name = _LIBRARIES if on_windows else _VENDORS
    if os.environ.get(name) or (library := installed_library()) is None:
        return
    if on_windows:
        os.environ[name] = str(library)
        os.environ["PATH"] = os.pathsep.join((str(library.parent), os.environ.get("PATH", "")))
        return
    try:
        folder = folder_until_exit("opencl-drivers-")
        for driver in _SYSTEM.glob("*.icd"):
            shutil.copy(driver, folder)
        (folder / "intel-by-pip.icd").write_text(f"{library}\n", "utf-8")
    except OSError:  # the system's drivers remain
        return
    os.environ[name] = str(folder)


def installed_library() -> Path | None:
    """Return the runtime's library in this environment, or None."""
    try:
        recorded = files("intel-opencl-rt") or ()
    except PackageNotFoundError:
        return None
    found = (Path(str(file.locate())).resolve() for file in recorded if file.name in _NAMES)
    return next((library for library in found if library.exists()), None)
