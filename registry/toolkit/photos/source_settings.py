"""Settings that scene loaders share: source folder and size of photographs, split of the views."""

from __future__ import annotations

import logging
from typing import TYPE_CHECKING, Literal

from pydantic import Field

from ...contract.component import Settings
from ...errors import SceneError
from .decoder import Decoder, ResizeFilter, divided_by
from .masks.files import is_mask_folder
from .reading import IMAGE_SUFFIXES, list_images

if TYPE_CHECKING:
    from pathlib import Path

HELD_OUT_EVERY = 8
"""Every eighth photograph is a test view, where there are at least as many."""

_log = logging.getLogger("stereogs.photos")


class ImageSourceSettings(Settings):
    """Settings of loaders for captures that are stored at several sizes; they are part of a protocol."""

    downsample: int = Field(8, ge=1)
    """Full-size width divided by training width; the same for the height."""
    images: str | None = None
    """Folder of the photographs inside the scene's folder; null means images, or images_N for
    photographs that are stored at the size of `downsample`: N."""
    image_source: Literal["folder", "resize"] = "folder"
    """`folder` uses photographs at their stored size; `resize` downsamples full-size ones on loading."""
    resize_filter: ResizeFilter = "bicubic"
    """Pillow's filter for `image_source: resize` and `max_size`. Distorted photographs use `lanczos`."""
    max_size: int | None = Field(None, ge=16)
    """Longer side of the photographs, at most, in pixels; larger ones are resized. null: no limit."""

    def decoder(self) -> Decoder:
        """Return a decoder for these settings."""
        divisor = self.downsample if self.image_source == "resize" else 1
        return Decoder(divided_by(divisor, self.max_size), self.resize_filter)

    def image_folder(self, scene: Path) -> Path:
        """Return the folder of the photographs.

        Raises:
            SceneError: The folder is missing or has no images; the error lists the folders that exist.
        """
        full_size = self.image_source == "resize" or self.downsample == 1
        folder = scene / (self.images or ("images" if full_size else f"images_{self.downsample}"))
        if not _has_images(folder):
            present = _image_folders(scene)
            if full_size and not self.images and len(present) == 1:
                name = present[0].relative_to(scene)
                _log.info("%s is missing: photographs are those of %s", folder, name)
                return present[0]
            names = ", ".join(str(path.relative_to(scene)) for path in present)
            which = "" if self.images else f" for downsample {self.downsample}"
            fix = f"set `downsample` or `images` to an existing folder (found: {names})"
            if not names:
                fix = "set `path` to the folder that holds the photographs and their cameras"
            files = [path for path in folder.iterdir() if path.is_file()] if folder.is_dir() else []
            if suffixes := sorted({path.suffix.lower() for path in files}):
                fix = f"convert the pictures to JPEG or PNG; {', '.join(suffixes)} cannot be read"
            raise SceneError(f"images are missing{which}", where=str(folder), fix=fix)
        return folder


def _image_folders(scene: Path) -> list[Path]:
    """Return the folders images_N that have photographs; if there is none, the other ones that have."""
    if not scene.is_dir():
        return []
    folders = sorted(path for path in scene.iterdir() if path.is_dir() and not is_mask_folder(path))
    named = [path for path in folders if path.name.startswith("images") and _has_images(path)]
    others = [path for path in [*folders, scene] if list_images(path)]
    return named or others


def _has_images(folder: Path) -> bool:
    """Return whether a folder, or a folder in it, has a photograph."""
    return bool(list_images(folder)) or any(
        path.suffix.lower() in IMAGE_SUFFIXES for path in folder.rglob("*")
    )


class SplitSettings(Settings):
    """Settings of loaders that choose training and test views by number."""

    train_views: int | None = Field(None, ge=0)
    """Number of training views; null or 0 takes all photographs that are not test views."""
    test_every: int | None = Field(None, ge=0)
    """Every N-th photograph of the sorted list is a test view, starting with the first; 0 gives no test
    views. null means 8, and 0 for fewer than eight photographs."""

    def split(self, count: int, where: str) -> tuple[list[int], list[int], str]:
        """Return the indices of training and test views among `count` sorted photographs, and the rule.

        With 8 as `test_every`, this is the split of RegNeRF and later sparse-view papers: every 8th
        photograph is a test view; of the other photographs T, the training views are `T[round(x)]` for x
        in `linspace(0, len(T) - 1, n)`.

        Raises:
            SceneError: Fewer than `train_views` photographs are not test views.
        """
        test_every = _default_test_every(count) if self.test_every is None else self.test_every
        test = list(range(0, count, test_every)) if test_every else []
        pool = sorted({*range(count)} - {*test})
        train = self.chosen(pool, where)
        if unused := len(pool) - len(train):
            _log.info(
                "%d photographs: %d train, %d are held out, %d are not used; --set scene.train_views=0 "
                "trains on all that are not held out",
                *(count, len(train), len(test), unused),
            )
        if not test_every:
            return train, test, "evenly spaced train, none tests"
        return train, test, f"every {test_every}th tests, the others evenly spaced train"

    def chosen(self, pool: list[int], where: str) -> list[int]:
        """Return `train_views` evenly spaced members of those that are not test views.

        Raises:
            SceneError: there are fewer.
        """
        if not pool or (self.train_views or 0) > len(pool):
            fewer = f"set `train_views` to at most {len(pool)}, or " if pool else ""
            raise SceneError(
                f"{self.train_views or 1} training views are wanted, but only {len(pool)} photographs are "
                "not test views",
                where=where,
                fix=f"{fewer}raise `test_every`",
            )
        return evenly_spaced(pool, self.train_views)


def _default_test_every(count: int) -> int:
    """Return the spacing of test views among `count` photographs; 0 gives no test views."""
    if count < HELD_OUT_EVERY:
        _log.info(
            "%d photographs, fewer than %d: all train; --test-every %d holds out every %dth",
            *(count, *[HELD_OUT_EVERY] * 3),
        )
        return 0
    _log.info(
        "%d photographs: every %dth is held out to score new views; --test-every 0 trains on all",
        *(count, HELD_OUT_EVERY),
    )
    return HELD_OUT_EVERY


def evenly_spaced(pool: list[int], wanted: int | None) -> list[int]:
    """Return `wanted` evenly spaced members of the pool, including both ends; None or 0 returns all."""
    import numpy as np

    # numpy rounds halves to even, as the published splits do.
    chosen = np.round(np.linspace(0, len(pool) - 1, wanted or len(pool))).astype(int)
    return [pool[k] for k in chosen]
