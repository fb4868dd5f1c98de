"""What is fuzzed: a format with whole files, and a reader that answers or explains."""

from __future__ import annotations

from abc import ABC, abstractmethod
from pathlib import Path
from typing import ClassVar

from core_rasterizer import ExplainedError


class Target(ABC):
    """A format. Constructing it writes whole files into a folder.

    Args:
        folder: of its own, empty.

    Attributes:
        files: the names of the files that are damaged, below `folder`.
    """

    name: ClassVar[str]
    files: tuple[str, ...]

    def __init__(self, folder: Path) -> None:
        self.folder = folder
        self.files = self.write()
        self._whole = {file: (folder / file).read_bytes() for file in self.files}

    @abstractmethod
    def write(self) -> tuple[str, ...]:
        """Write the whole files; returns the names of those that are damaged."""

    @abstractmethod
    def read(self) -> None:
        """Read what lies in the folder, and assert that what is accepted is good.

        Raises:
            ExplainedError: it is refused.
            AssertionError: it is accepted and must not be.
        """

    def whole(self, file: str) -> bytes:
        """The undamaged content of a file."""
        return self._whole[file]

    def accepts(self, file: str, content: bytes) -> bool:
        """Whether it is still read with one file replaced; whatever else is raised passes."""
        (self.folder / file).write_bytes(content)
        try:
            self.read()
        except ExplainedError:
            return False
        finally:
            self.restore(file)
        return True

    def restore(self, file: str) -> None:
        """Put the undamaged file back."""
        (self.folder / file).write_bytes(self._whole[file])
