"""Which folder the photographs come from, and at what size: a field of a protocol, for it moves results."""

from __future__ import annotations

from typing import TYPE_CHECKING, Literal

from pydantic import Field

from ....contract.component import Settings
from ....errors import SceneError
from .decoder import Decoder, ResizeFilter
from .image_files import list_images
from .sizes import divided_by

if TYPE_CHECKING:
    from pathlib import Path


class ImageSourceSettings(Settings):
    """Settings that loaders of captures at several sizes share."""

    downsample: int = Field(8, ge=1)
    """Training photographs are this much smaller than the full-size ones, on each side."""
    images: str | None = None
    """The folder of the photographs inside the scene's; null means images, or images_N where the
    photographs are stored at the size of `downsample`: N."""
    image_source: Literal["folder", "resize"] = "folder"
    """`folder` takes photographs as they are stored; `resize` reduces full-size ones on loading."""
    resize_filter: ResizeFilter = "bicubic"
    """Pillow's filter for `image_source: resize`."""

    def decoder(self) -> Decoder:
        """How photographs are read under these settings."""
        if self.image_source == "resize":
            return Decoder(size=divided_by(self.downsample), resize_filter=self.resize_filter)
        return Decoder()

    def image_folder(self, scene: Path) -> Path:
        """The folder of the photographs.

        Raises:
            SceneError: it does not exist or holds no image; says which folders do.
        """
        full_size = self.image_source == "resize" or self.downsample == 1
        folder = scene / (self.images or ("images" if full_size else f"images_{self.downsample}"))
        if not list_images(folder):
            present = ", ".join(sorted(path.name for path in scene.glob("images*"))) or "none"
            raise SceneError(
                "there are no images"
                + ("" if self.images else f" for downsample {self.downsample}"),
                where=str(folder),
                fix=f"set `downsample` or `images` to a folder that is there (found: {present})",
            )
        return folder
