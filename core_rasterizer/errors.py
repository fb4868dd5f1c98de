"""Errors of the engine, and the root of every error that a user of the project may see.

ExplainedError                what happened, where, and how to mend it
├── DeviceError               no OpenCL device, an unknown name, a kernel that does not build
├── CameraError               a camera that cannot project
├── GaussianError             Gaussians of a wrong shape, type or value; names field and index
├── PlyError                  a PLY file that cannot be read
└── MemoryBudgetError         a scene that would not fit, with numbers
"""

from __future__ import annotations


class ExplainedError(Exception):
    """An error that a person can act on.

    Args:
        what: one sentence: what happened.
        where: the place: a file and line, a field and index, a plugin and iteration. May be empty.
        fix: what to do about it. May be empty.
    """

    def __init__(self, what: str, *, where: str = "", fix: str = "") -> None:
        super().__init__(what)
        self.what = what
        self.where = where
        self.fix = fix

    def __str__(self) -> str:
        lines = [self.what]
        if self.where:
            lines.append(f"  where  {self.where}")
        if self.fix:
            lines.append(f"  fix    {self.fix}")
        return "\n".join(lines)


class DeviceError(ExplainedError):
    """No usable OpenCL device, or one that refused a kernel."""


class CameraError(ExplainedError):
    """A camera that cannot project: non-finite pose, focal length or size out of range."""


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
    """The work asked for would need more memory than the budget allows."""
