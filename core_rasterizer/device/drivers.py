"""The installed OpenCL drivers."""

from __future__ import annotations

import pyopencl as cl

from ..errors import DeviceError
from .compiled import POCL_CACHE_DIR, pocl_cache, problem_of, provide_pocl_cache

_POCL = "Portable Computing Language"


def platforms() -> list[cl.Platform]:
    """Return the installed drivers. If one is PoCL, it has a cache that can be written, if any folder can."""
    try:
        found = cl.get_platforms()
    except cl.Error:  # raised when no platform is installed
        return []
    if any(_POCL in platform.name for platform in found):
        provide_pocl_cache()
    return list(found)


def no_device() -> DeviceError:
    """Return the error that says why no device is listed."""
    names = [str(platform.name) for platform in platforms()]
    driver = "`pip install pocl-binary-distribution` brings one for any CPU"
    if not names:
        return DeviceError("no OpenCL platform was found", fix=f"install a driver: {driver}")
    if any(_POCL in name for name in names) and (problem := problem_of(pocl_cache())):
        return DeviceError(
            f"PoCL lists no device, because its cache {problem}",
            where=str(pocl_cache()),
            fix=f"set {POCL_CACHE_DIR} to a folder that can be written",
        )
    return DeviceError(
        f"the installed OpenCL drivers list no device: {', '.join(names)}",
        fix=f"update the driver, or install another: {driver}",
    )
