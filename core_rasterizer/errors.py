"""Errors of the engine, and the base class of every error that users of the project see.

ExplainedError                what happened, where, and how to fix it
├── DeviceError               no OpenCL device, an unknown name, a kernel that does not build
├── CameraError               an invalid camera
├── GaussianError             Gaussians of a wrong shape, type or value; names field and index
├── PlyError                  a PLY file that cannot be read or written
└── MemoryBudgetError         more memory needed than allowed, with numbers
"""

from __future__ import annotations


class ExplainedError(Exception):
    """An error with a location and a fix.

    Args:
        what: one sentence that describes the error.
        where: file and line, field and index, or plugin and iteration. May be empty.
        fix: how to avoid it. May be empty.
    """

    def __init__(self, what: str, *, where: str = "", fix: str = "") -> None:
        super().__init__(what)
        self.what = what
        self.where = where
        self.fix = fix

    def __str__(self) -> str:
        labelled = (("where", self.where), ("fix", self.fix))
        indented = [(label, text.replace("\n", "\n" + " " * 9)) for label, text in labelled if text]
        return "\n".join([self.what, *(f"  {label:<6} {text}" for label, text in indented)])


class DeviceError(ExplainedError):
    """No usable OpenCL device, or a kernel that failed on it."""


class CameraError(ExplainedError):
    """A camera with a non-finite pose, or a focal length or size out of range."""


class GaussianError(ExplainedError):
    """Gaussians of a wrong shape, type or value."""

    def __init__(
        self, what: str, *, field: str, index: int | None = None, where: str = "", fix: str = ""
    ) -> None:
        place = field if index is None else f"{field}[{index}]"
        super().__init__(what, where=f"{where}: {place}" if where else place, fix=fix)
        self.field = field
        self.index = index


class PlyError(ExplainedError):
    """A PLY file that is missing, malformed, or not a Gaussian scene."""


class MemoryBudgetError(ExplainedError):
    """An operation needs more memory than the budget allows."""
