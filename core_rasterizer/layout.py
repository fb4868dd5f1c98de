"""Memory layout of the parameters, for Python and the kernels.

Parameters are an array `[rows, capacity]`: a row is one scalar parameter of all Gaussians, a column one
Gaussian. SH rows come last, three channels per coefficient.
"""

from __future__ import annotations

from .gaussians import sh_coefficients

_WIDTHS = {"means": 3, "log_scales": 3, "quaternions": 4, "opacity_logits": 1}
"""Number of rows of each parameter before the SH coefficients, in order."""

PARAMETERS = (*_WIDTHS, "sh")
"""Names of the parameters, in the order of their rows."""

ROWS_BEFORE_SH = sum(_WIDTHS.values())
"""Number of rows before the SH coefficients."""

_ENDS = [sum(list(_WIDTHS.values())[: number + 1]) for number in range(len(_WIDTHS))]
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

CAPACITY_STEP = 16
"""Parameter arrays are padded to a multiple of this, the widest vector of any kernel."""

KERNEL_MACROS = {
    "ROW_MEAN": _ROWS["means"][0],
    "ROW_SCALE": _ROWS["log_scales"][0],
    "ROW_QUATERNION": _ROWS["quaternions"][0],
    "ROW_OPACITY": _ROWS["opacity_logits"][0],
    "ROW_SH": ROWS_BEFORE_SH,
    "CAPACITY_STEP": CAPACITY_STEP,
    **{f"BIT_{name.upper()}": bit for name, bit in PARAMETER_BITS.items()},
}
"""Macros of every kernel: first row and bit of each parameter, and the padding."""


def row_count(sh_degree: int) -> int:
    """Number of scalar parameters of a Gaussian with SH bands up to `sh_degree` (0 to 3)."""
    return ROWS_BEFORE_SH + 3 * sh_coefficients(sh_degree)


def rows_of(name: str, sh_degree: int) -> tuple[int, int]:
    """The rows `[first, last)` of one of `PARAMETERS` in an array with bands up to `sh_degree`."""
    return (ROWS_BEFORE_SH, row_count(sh_degree)) if name == "sh" else _ROWS[name]


def padded(count: int) -> int:
    """The capacity of parameter arrays that hold `count` Gaussians."""
    return max(CAPACITY_STEP, -(-count // CAPACITY_STEP) * CAPACITY_STEP)
