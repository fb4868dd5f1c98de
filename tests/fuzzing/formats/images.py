"""Photographs in all supported formats."""

from __future__ import annotations

import numpy as np
from PIL import Image

from registry import SceneError
from registry.toolkit.photos import Decoder
from tests.fuzzing.target import Target

_KINDS = ("png", "jpg", "webp", "tif", "bmp")


class Images(Target):
    """A small photograph per format. A damaged PNG is refused or read unchanged."""

    name = "images"

    def write(self) -> tuple[str, ...]:
        """Write noise, so that all parts of the files matter."""
        pixels = np.random.default_rng(0).integers(0, 256, (6, 8, 3), dtype=np.uint8)
        for kind in _KINDS:
            Image.fromarray(pixels).save(self.folder / f"a.{kind}")
        return tuple(f"a.{kind}" for kind in _KINDS)

    def accepts(self, file: str, content: bytes) -> bool:
        """Read the damaged image only."""
        (self.folder / file).write_bytes(content)
        try:
            pixels = Decoder().read(self.folder / file)
        except SceneError:
            return False
        finally:
            self.restore(file)
        assert pixels.dtype == np.uint8
        assert pixels.ndim == 3
        if file.endswith(".png"):
            assert np.array_equal(pixels, Decoder().read(self.folder / file))
        return True

    def read(self) -> None:
        """Read all images."""
        for kind in _KINDS:
            Decoder().read(self.folder / f"a.{kind}")
