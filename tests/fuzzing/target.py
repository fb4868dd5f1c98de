"""Base of fuzzing targets: a format with valid files and a reader."""

from __future__ import annotations

from abc import ABC, abstractmethod
from pathlib import Path
from typing import ClassVar

from core_rasterizer import ExplainedError


class Target(ABC):
    """A format; the constructor writes valid files into a folder.

    Args:
        folder: An empty folder.

    Attributes:
        files: Names of the files to damage, relative to `folder`.
    """

    name: ClassVar[str]
    files: tuple[str, ...]

    def __init__(self, folder: Path) -> None:
        self.folder = folder
        self.files = self.write()
        self._whole = {file: (folder / file).read_bytes() for file in self.files}

    @abstractmethod
    def write(self) -> tuple[str, ...]:
        """Write valid files; return the names of those to damage."""

    @abstractmethod
    def read(self) -> None:
        """Read the files, and check the result.

        Raises:
            ExplainedError: The files are refused.
            AssertionError: The files are accepted, but the result is invalid.
        """

    def whole(self, file: str) -> bytes:
        """Return the undamaged content of a file."""
        return self._whole[file]

    def accepts(self, file: str, content: bytes) -> bool:
        """Return whether reading succeeds with one file replaced; errors that are not explained propagate."""
        (self.folder / file).write_bytes(content)
        try:
            self.read()
        except ExplainedError:
            return False
        finally:
            self.restore(file)
        return True

    def restore(self, file: str) -> None:
        """Restore the undamaged file."""
        (self.folder / file).write_bytes(self._whole[file])
