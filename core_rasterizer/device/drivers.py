"""The installed OpenCL drivers, and the folders in which PoCL and pyopencl keep what they compile.

PoCL lists no device if it cannot write its folder, rejects every build if the folder exists but is
read-only, and ends the process if the disk is full. pyopencl raises an error of SQLite.
"""

from __future__ import annotations

import atexit
import logging
import os
import shutil
import sys
import tempfile
from functools import cache
from importlib.metadata import PackageNotFoundError, files
from pathlib import Path
from typing import TYPE_CHECKING

from ..errors import DeviceError

if TYPE_CHECKING:
    import pyopencl as cl

POCL_CACHE_DIR = "POCL_CACHE_DIR"
"""Environment variable: the folder in which PoCL keeps compiled kernels."""
_PYOPENCL_NO_CACHE = "PYOPENCL_NO_CACHE"
"""Environment variable: 1 keeps nothing. pyopencl reads it when it is imported."""
_POCL = "Portable Computing Language"
INTEL = "pip install 'stereogs-rasterizer[intel]'"
"""Command that installs the runtime."""
_VENDORS = "OCL_ICD_VENDORS"
"""Environment variable: a folder of .icd files, which name drivers' libraries, instead of the system's."""
_FILENAMES = "OCL_ICD_FILENAMES"
"""Environment variable of Khronos's loader: further drivers' libraries."""
_SYSTEM = Path("/etc/OpenCL/vendors")
_INTEL_LIBRARIES = ("libintelocl.so", "intelocl64.dll")
_ADVICE = {
    "linux": "`pip install pocl-binary-distribution` brings one for x86-64 CPUs",
    "win32": f"`{INTEL}` brings one for x86-64 CPUs",
}
_SPACE = 20_000_000
"""Bytes that a folder needs; all kernels of a run take one million."""
_log = logging.getLogger(__name__)


def platforms() -> list[cl.Platform]:
    """Return the installed drivers. If one is PoCL, it has a cache that can be written, if any folder can."""
    import pyopencl as cl

    try:
        found = cl.get_platforms()
    except cl.Error:  # raised when no platform is installed
        return []
    if any(_POCL in platform.name for platform in found):
        _provide_pocl_cache()
    return list(found)


def no_device() -> DeviceError:
    """Return the error that says why no device is listed."""
    names = [str(platform.name) for platform in platforms()]
    driver = _ADVICE.get(sys.platform, "the maker of your GPU or CPU has one")
    if not names:
        return DeviceError("no OpenCL platform was found", fix=f"install a driver: {driver}")
    if any(_POCL in name for name in names) and (problem := problem_of(_pocl_cache())):
        return DeviceError(
            f"PoCL lists no device, because its cache {problem}",
            where=str(_pocl_cache()),
            fix=f"set {POCL_CACHE_DIR} to a folder that can be written",
        )
    return DeviceError(
        f"the installed OpenCL drivers list no device: {', '.join(names)}",
        fix=f"update the driver, or install another: {driver}",
    )


def _skip_pyopencl_cache() -> None:
    """Let pyopencl keep nothing if it could not; to be called before it is imported."""
    if os.name == "posix" and problem_of(_caches() / "pytools"):
        os.environ.setdefault(_PYOPENCL_NO_CACHE, "1")


@cache
def _provide_pocl_cache() -> None:
    """If PoCL cannot use its cache, give it one until the process ends; child processes share it."""
    if os.name != "posix":
        return
    if os.environ.get(POCL_CACHE_DIR) == "":
        del os.environ[POCL_CACHE_DIR]  # PoCL would try to create the folder ""
    folder = _pocl_cache()
    problem = problem_of(folder)
    if not problem:
        return
    advice = f"set {POCL_CACHE_DIR} to a folder on a disk with free space"
    try:
        other = _folder_until_exit("pocl-")
    except OSError:  # no device is found then, which `no_device` explains
        return
    if remaining := problem_of(other):
        _log.warning(
            "PoCL's cache %s %s, and %s %s: PoCL may end the process (LLVM ERROR); %s",
            *(folder, problem, other.parent, remaining, advice),
        )
        return
    os.environ[POCL_CACHE_DIR] = str(other)
    _log.warning(
        "PoCL's cache %s %s: kernels are compiled anew in every run; %s", folder, problem, advice
    )


def _pocl_cache() -> Path:
    """Return PoCL's cache by the rule of its `pocl_cache_init_topdir`."""
    if given := os.environ.get(POCL_CACHE_DIR):
        return Path(given)
    if os.environ.get("XDG_CACHE_HOME") or os.environ.get("HOME"):
        return _caches() / "pocl" / "kcache"
    return Path("/", "tmp", "pocl", "kcache")


def problem_of(folder: Path) -> str:
    """Return why a folder cannot hold compiled kernels, "" if it can; create it if it does not exist."""
    try:
        folder.mkdir(parents=True, exist_ok=True)
        tempfile.TemporaryFile(dir=folder).close()
        free = shutil.disk_usage(folder).free
    except OSError as error:
        return f"cannot be written ({error.strerror or error})"
    return f"has {free / 1e6:.1f} MB of free space" if free < _SPACE else ""


def _caches() -> Path:
    return Path(os.environ.get("XDG_CACHE_HOME") or Path("~/.cache").expanduser())


def _offer_intel_runtime() -> None:
    """Tell the OpenCL loader of Intel's runtime if pip installed it; to be called before its first use.

    A loader finds drivers in /etc/OpenCL/vendors, in the registry of Windows, or by an environment variable.
    pip can write to neither of the first two. A variable that the user set stays; child processes inherit it.
    """
    on_windows = sys.platform == "win32"
    name = _FILENAMES if on_windows else _VENDORS
    if os.environ.get(name) or (library := intel_library()) is None:
        return
    if on_windows:
        os.environ[name] = str(library)
        os.environ["PATH"] = os.pathsep.join((str(library.parent), os.environ.get("PATH", "")))
        return
    try:
        folder = _folder_until_exit("opencl-drivers-")
        for driver in _SYSTEM.glob("*.icd"):
            shutil.copy(driver, folder)
        (folder / "intel-by-pip.icd").write_text(f"{library}\n", "utf-8")
    except OSError:  # the system's drivers remain
        return
    os.environ[name] = str(folder)


def intel_library() -> Path | None:
    """Return the library of Intel's runtime in this environment, or None."""
    try:
        recorded = files("intel-opencl-rt") or ()
    except PackageNotFoundError:
        return None
    found = (
        Path(str(file.locate())).resolve() for file in recorded if file.name in _INTEL_LIBRARIES
    )
    return next((library for library in found if library.exists()), None)


def _folder_until_exit(prefix: str) -> Path:
    """Create a folder; it is removed when this process ends, and not when its forked children do.

    Raises:
        OSError: none can be created.
    """
    folder = Path(tempfile.mkdtemp(prefix=prefix))
    atexit.register(_remove, folder, os.getpid())
    return folder


def _remove(folder: Path, process: int) -> None:
    if os.getpid() == process:
        shutil.rmtree(folder, ignore_errors=True)


_skip_pyopencl_cache()
_offer_intel_runtime()
