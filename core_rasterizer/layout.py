"""Layout of the arrays that kernels and the host share; the macros of the kernels are generated from it.

Parameters are an array `[rows, capacity]`: a row is one scalar parameter of all Gaussians, a column one
Gaussian. SH rows come last, three channels per coefficient.
"""

from __future__ import annotations

from collections.abc import Sequence
from itertools import accumulate

from .gaussians import sh_coefficients

_WIDTHS = {"means": 3, "log_scales": 3, "quaternions": 4, "opacity_logits": 1}
"""Number of rows of each parameter before the SH coefficients, in order."""

PARAMETERS = (*_WIDTHS, "sh")
"""Names of the parameters, in the order of their rows."""

ROWS_BEFORE_SH = sum(_WIDTHS.values())
"""Number of rows before the SH coefficients."""

_ENDS = accumulate(_WIDTHS.values())
_ROWS = {
    name: (end - width, end) for (name, width), end in zip(_WIDTHS.items(), _ENDS, strict=True)
}

PARAMETER_GROUPS: dict[str, tuple[int, int | None]] = {
    **_ROWS,
    "sh_constant": (ROWS_BEFORE_SH, ROWS_BEFORE_SH + 3),
    "sh_rest": (ROWS_BEFORE_SH + 3, None),
}
"""Rows `[first, last)` that share a learning rate; the last group has all remaining rows."""

PARAMETER_BITS = {name: 1 << number for number, name in enumerate(PARAMETERS)}
"""One bit per parameter, for sets of parameters in kernel arguments."""

MAX_LOGIT = 30
"""Largest magnitude of an opacity logit after a step of Adam. There the opacity is 1 in single precision, and
the sigmoid's slope of 9e-14 is still large enough for Adam; at 100 it is not, and a logit would never return.
"""

LARGEST = 1e37
"""REAL_LARGEST of the kernels; larger values are not rendered, larger gradients become 0."""

CAPACITY_STEP = 16
"""Parameter arrays are padded to a multiple of this, the widest vector of any kernel."""


class Record:
    """A block of numbers with names: the kernels' macros PREFIX_NAME are their places.

    Args:
        prefix: of the macros.
        size: numbers of a block; places after the last name are unused.
        names: in order, separated by blanks; "name:3" has three numbers.

    Attributes:
        first: place of each name's first number.
        macros: of the kernels.
    """

    def __init__(self, prefix: str, size: int, names: str) -> None:
        self.size = size
        pairs = [name.partition(":") for name in names.split()]
        self._widths = {name: int(width or 1) for name, _, width in pairs}
        ends = list(accumulate(self._widths.values()))
        assert ends[-1] <= size
        self.first = dict(zip(self._widths, [0, *ends[:-1]], strict=True))
        places = {f"{prefix}_{name.upper()}": place for name, place in self.first.items()}
        self.macros = {f"{prefix}_SIZE": size, **places}

    def packed(self, **values: float | Sequence[float]) -> list[float]:
        """A block from its named numbers, all of them."""
        assert set(values) == set(self._widths)
        block = [0.0] * self.size
        for name, width in self._widths.items():
            given = values[name]
            numbers = given if isinstance(given, Sequence) else (given,)
            assert len(numbers) == width, name
            block[self.first[name] : self.first[name] + width] = numbers
        return block


CAMERA = Record(
    "CAMERA",
    32,
    "rotation:9 translation:3 center:3 fx fy cx cy limits:4 width height near background:3 last_band",
)
"""Camera and options of a render, in the kernels' `wide`.

rotation: world to camera, row-major. limits: x low, x high, y low, y high of the clamped ratios x/z and y/z.
last_band: the weight of the last SH band, where it is a fraction. On a device without double a second block
follows: the rounding errors of all these numbers.
"""

GAUSSIAN = Record("REC", 16, "x y a b c opacity red green blue z rest_x rest_y x0 x1 y0 y1")
"""A projected Gaussian, for the raster stages; a cache line in float.

a, b, c: the exponent of 2 is a dx^2 + b dx dy + c dy^2. rest_x, rest_y: rounding errors of x and y; the mean
is their sum. x0 to y1: the pixels that it can reach, columns [x0, x1), rows [y0, y1).
"""

PAIR = Record("PAIR", 16, "p px py pxx pxy pyy red green blue z touched absolute_x absolute_y")
"""Sums over the pixels of a (tile, Gaussian) pair.

p: of dL/d(exponent), then its moments about the mean. touched: positive if any pixel was touched. absolute_x,
absolute_y: of absolute gradients of the mean, times log2(e); only of kernels built with ABSOLUTE.
"""

POSE = Record("POSE", 16, "rotation:9 translation:3 view:3")
"""Part of a block of Gaussians in the gradient of the pose, in `wide`.

rotation: row-major. view: the sum of dL/d(mean - camera centre) along the view directions of colours.
"""

COUNTERS = Record("COUNT", 4, "visible pairs listed last")
"""Numbers of a render, unsigned 64 bits.

visible: Gaussians. pairs: (tile, Gaussian) pairs. listed: the same number, as the lists of a CPU's tiles add
up. last: of tests.
"""


def _adam_macros() -> dict[str, int | str]:
    """Kernel arguments with a learning rate and a correction for each group, and their selection by row."""
    rates, corrections = list(PARAMETER_GROUPS), [f"correct_{name}" for name in PARAMETER_GROUPS]
    _, *later = (first for first, _ in PARAMETER_GROUPS.values())
    return {
        "ADAM_RATES": ", ".join(f"real {name}" for name in (*rates, *corrections)),
        "ADAM_RATES_BY_GROUP": f"const real rates[] = {{{', '.join(rates)}}}; "
        f"const real corrections[] = {{{', '.join(corrections)}}};",
        "ADAM_GROUP_OF(row)": f"({' + '.join(f'(row >= {first})' for first in later)})",
    }


_MACROS: dict[str, int | str] = {
    "ROW_MEAN": _ROWS["means"][0],
    "ROW_SCALE": _ROWS["log_scales"][0],
    "ROW_QUATERNION": _ROWS["quaternions"][0],
    "ROW_OPACITY": _ROWS["opacity_logits"][0],
    "ROW_SH": ROWS_BEFORE_SH,
    "CAPACITY_STEP": CAPACITY_STEP,
    "MAX_LOGIT": MAX_LOGIT,
    **{f"BIT_{name.upper()}": bit for name, bit in PARAMETER_BITS.items()},
    **CAMERA.macros,
    **GAUSSIAN.macros,
    **PAIR.macros,
    **POSE.macros,
    **COUNTERS.macros,
    **_adam_macros(),
}

KERNEL_HEADER = "".join(f"#define {name} {value}\n" for name, value in _MACROS.items())
"""Comes first in the source of every kernel."""


def row_count(sh_degree: int) -> int:
    """Number of scalar parameters of a Gaussian with SH bands up to `sh_degree` (0 to 3)."""
    return ROWS_BEFORE_SH + 3 * sh_coefficients(sh_degree)


def rows_of(name: str, sh_degree: int) -> tuple[int, int]:
    """The rows `[first, last)` of one of `PARAMETERS` in an array with bands up to `sh_degree`."""
    return (ROWS_BEFORE_SH, row_count(sh_degree)) if name == "sh" else _ROWS[name]


def padded(count: int) -> int:
    """The capacity of parameter arrays that hold `count` Gaussians."""
    return max(CAPACITY_STEP, -(-count // CAPACITY_STEP) * CAPACITY_STEP)
