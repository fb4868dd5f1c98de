"""Recognize copies of a photograph by what they show: in another format, size or quality, or rendered.

In a copy nothing moves. Between two photographs from different places something does, however near they are,
so motion decides, not the difference of colours: blocks of both pictures are registered (Lucas and Kanade
1981). The difference finds the pairs that are worth it.

Both thresholds were chosen on 580 photographs of 15 real and rendered scenes, 370 to 960 pixels long. Motion
is at most 0.16 for copies in JPEG and WebP of quality 50 and more, of a half, a third and a quarter of the
size, and 0.24 for blurred ones; the difference is at most 0.35, and 0.7 after a change of gamma. Photographs
moved by one pixel with noise have a motion of 0.44 at least; those of the scenes at least 0.8 if their
difference is below 1. One pair of the 580 is called a copy: a gantry that returned to its place.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, NamedTuple

if TYPE_CHECKING:
    import numpy as np
    from numpy.typing import NDArray
    from PIL import Image

    Grey = NDArray[np.uint8]
    Array = NDArray[np.float64]

MAX_MOTION = 0.3
"""Largest motion of a copy, in pixels of the compared pictures."""
MAX_DIFFERENCE = 1.0
"""Largest difference of a copy, in pixels of a picture of `_SIDE` pixels."""
_LONGER_SIDE = 320
"""Longer side of the pictures whose motion is measured, in pixels."""
_SIDE = 64
"""Width and height of the pictures whose difference is measured."""
_BLOCKS = 10
"""Blocks along each side that are registered."""
_SHAPE_TOLERANCE = 0.02
"""Largest relative difference of two proportions that rounding explains."""


class Impression(NamedTuple):
    """What is compared of a photograph.

    Args:
        picture: grey values `[H, W]`, up to 320 pixels long.
        square: `[4096]` float32, mean 0 and norm 1; zeros for a picture of one colour.
        steepness: root mean square of the slopes of `square`, in units of its standard deviation by pixel.
    """

    picture: Grey
    square: NDArray[np.float32]
    steepness: float

    @classmethod
    def of(cls, picture: Image.Image) -> Impression:
        """Return the impression of a photograph, turned as its EXIF data say.

        A JPEG that was not decoded before is decoded at a lower resolution, which is faster.
        """
        import numpy as np
        from PIL import Image, ImageOps

        picture.draft(None, (_LONGER_SIDE, _LONGER_SIDE))
        grey = ImageOps.exif_transpose(picture).convert("L")
        scale = min(1.0, _LONGER_SIDE / max(grey.size))
        width, height = (max(1, round(side * scale)) for side in grey.size)
        grey = grey.resize((width, height), Image.Resampling.BILINEAR)
        square = _normal(np.asarray(grey.resize((_SIDE, _SIDE), Image.Resampling.BILINEAR)))
        flat = (square / _SIDE).astype(np.float32).ravel()
        return cls(np.asarray(grey), flat, _steepness(square))

    @property
    def sharpness(self) -> float:
        """Root mean square of the slopes of `picture`, in units of its standard deviation by pixel.

        Compared with a photograph, at least 0.98 in a JPEG or WebP of it, and 0.9 at most in renders of 20 to
        25 dB.
        """
        return _steepness(_normal(self.picture))

    def turned(self, quarters: int) -> Impression:
        """Return the impression after counterclockwise quarter turns."""
        import numpy as np

        square = np.rot90(self.square.reshape(_SIDE, _SIDE), quarters).ravel()
        return self._replace(picture=np.rot90(self.picture, quarters), square=square)

    def is_copy_of(self, other: Impression) -> bool:
        """Return whether two photographs show the same; False for pictures without texture."""
        if not self._is_near(other):
            return False
        (height, width), (high, wide) = self.picture.shape, other.picture.shape
        tolerance = max(_SHAPE_TOLERANCE, 1 / min(width, wide, height, high))
        if abs(width * high / (height * wide) - 1) > tolerance:
            return False
        return _motion(self.picture, other.picture) < MAX_MOTION

    def _is_near(self, other: Impression) -> bool:
        """Whether the difference is at most as large as after a motion of `MAX_DIFFERENCE`."""
        most = MAX_DIFFERENCE * min(self.steepness, other.steepness)
        return 2 - 2 * float(self.square @ other.square) < most**2


def _motion(one: Grey, other: Grey) -> float:
    """Return the motion that a quarter of the textured blocks exceed, in pixels of the smaller picture."""
    import numpy as np
    from PIL import Image

    height, width = min(one.shape, other.shape)
    first, second = (
        _normal(np.asarray(Image.fromarray(p).resize((width, height), Image.Resampling.BILINEAR)))
        for p in (one, other)
    )
    high, wide = height // _BLOCKS, width // _BLOCKS

    def summed(values: Array) -> Array:
        whole = values[: high * _BLOCKS, : wide * _BLOCKS]
        sums: Array = whole.reshape(_BLOCKS, high, _BLOCKS, wide).sum(axis=(1, 3)).ravel()
        return sums

    down, right = _slopes((first + second) / 2)
    change = first - second
    xx, xy, yy = summed(right * right), summed(right * down), summed(down * down)
    xt, yt = summed(right * change), summed(down * change)
    determinant = xx * yy - xy * xy
    # The smaller eigenvalue of the structure tensor, as in Shi and Tomasi 1994.
    texture = (xx + yy - np.sqrt((xx - yy) ** 2 + 4 * xy * xy)) / 2
    clear = texture > max(texture.mean() / 2, 1e-9)
    if not clear.any():
        return np.inf
    moved = np.hypot(yy * xt - xy * yt, xx * yt - xy * xt)[clear] / determinant[clear]
    return float(np.percentile(moved, 75))


def _slopes(values: Array) -> tuple[Array, Array]:
    """Return the derivatives along the rows' and the columns' numbers."""
    import numpy as np

    return np.gradient(values, axis=0), np.gradient(values, axis=1)


def _steepness(values: Array) -> float:
    """Return the root mean square of the slopes."""
    down, right = _slopes(values)
    return float(((down**2 + right**2).mean() / 2) ** 0.5)


def _normal(grey: Grey) -> Array:
    """Return the picture with mean 0 and standard deviation 1, or zeros."""
    import numpy as np

    values = grey - grey.mean(dtype=np.float64)
    deviation: Array = values / max(float(values.std()), 1e-9)
    return deviation
