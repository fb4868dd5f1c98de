"""The source of the kernel of a `PixelTerm`, from its author's statements for one pixel."""

from __future__ import annotations

from functools import lru_cache

from ..device import KernelText

GROUP = 256
"""Pixels per work-group of a GPU, where pixels run in parallel."""

_TYPES = {"image": "__global const real *", "mask": "__global const uchar *"}
_ROWS = """
{
    const int y = get_global_id(0), first = y * width;
    real loss = 0, largest = 0;
    CLEAR(first, width)
    for (int x = 0; x < width; x++) {
        const int p = first + x;
#line 1
SOURCE
    }
    MEASURE(first, width)
    sums[2 * y] = loss;
    sums[2 * y + 1] = largest;
}
"""
_PIXELS = """
{
    __local real losses[GROUP], bounds[GROUP];
    const int p = get_global_id(0), id = get_local_id(0), x = p % width, y = p / width;
    real loss = 0, largest = 0;
    if (y < height) {
        CLEAR(p, 1)
        for (int once = 1; once; once = 0) {
#line 1
SOURCE
        }
        MEASURE(p, 1)
    }
    losses[id] = loss;
    bounds[id] = largest;
    for (int next = GROUP / 2; next; next /= 2) {
        barrier(CLK_LOCAL_MEM_FENCE);
        if (id < next) {
            losses[id] += losses[id + next];
            bounds[id] = bounds[id] > bounds[id + next] ? bounds[id] : bounds[id + next];
        }
    }
    if (!id) {
        sums[2 * get_group_id(0)] = losses[0];
        sums[2 * get_group_id(0) + 1] = bounds[0];
    }
}
"""


@lru_cache
def pixel_kernel(
    source: str,
    helpers: str,
    name: str,
    kinds: tuple[tuple[str, str], ...],
    given: tuple[tuple[str, bool], ...],
    gradients: tuple[tuple[str, int], ...],
    rows: bool,
) -> KernelText:
    """The kernel `pixel_term`.

    It clears the gradients, runs the statements for each pixel, and writes two sums for each row or group:
    the loss, and the largest absolute gradient, which is infinite if one is not finite.

    Args:
        source, helpers, name: see `PixelTerm`.
        kinds: "image", "mask", "real" or "int" by the input's name.
        given: whether an argument of the term is not None, by its name.
        gradients: number of channels by the input's name.
        rows: one work-item for each row, or for each pixel.
    """
    arguments = [f"{_TYPES.get(kind, kind + ' ')}{title}" for title, kind in kinds]
    arguments += [f"__global real *d_{title}" for title, _ in gradients]
    arguments += ["__global real *sums", "int width", "int height"]
    flags = [f"#define HAS_{title} {int(there)}" for title, there in given]
    clear = _for_each_gradient(gradients, "VALUE = 0;")
    measure = _for_each_gradient(
        gradients,
        "const real size = VALUE < 0 ? -VALUE : VALUE; "
        "largest = !(size < INFINITY) ? INFINITY : size > largest ? size : largest;",
    )
    lines = [
        *flags,
        helpers,
        f"#define GROUP {GROUP}",
        f"#define CLEAR(first, count) {clear}",
        f"#define MEASURE(first, count) {measure}",
        f"__kernel void pixel_term({', '.join(arguments)})",
        (_ROWS if rows else _PIXELS).replace("SOURCE", source),
    ]
    return KernelText(name, "\n".join(lines))


def _for_each_gradient(gradients: tuple[tuple[str, int], ...], statement: str) -> str:
    """A loop over the values of each gradient in a span of pixels."""
    return " ".join(
        f"for (int k = {channels} * (first); k < {channels} * ((first) + (count)); k++) "
        f"{{ {statement.replace('VALUE', f'd_{title}[k]')} }}"
        for title, channels in gradients
    )
