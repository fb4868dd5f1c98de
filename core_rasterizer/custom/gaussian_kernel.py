"""Numbers of all Gaussians from one kernel, which reads parameters and gradients where they are stored."""

from __future__ import annotations

import re
from collections.abc import Collection, Mapping
from functools import lru_cache
from typing import TYPE_CHECKING, NamedTuple

import torch
from torch import Tensor

from ..device import DeviceArray, KernelText
from ..errors import ExplainedError
from ..layout import padded

if TYPE_CHECKING:
    from ..optimization import GaussianReader

GROUP = 256
"""Gaussians per work-group of a GPU."""
CHUNKS = 16
"""Work-items of a CPU."""

_CHUNK = """
    for (int block = 0; block < span; block++) {
        const int i = (get_global_id(0) * span + block) * LANES;
        if (i >= count)
            break;
        BODY
    }
"""
_ITEM = """
    const int i = get_global_id(0);
    if (i < count) {
        BODY
    }
"""
_SUM_OF_LANES = """
    {
        real sum = 0;
        for (int l = 0; l < LANES; l++)
            sum += LANE_AT(total_NAME, l);
        results[(size_t)OUTPUTS * capacity + SUMS * get_global_id(0) + PLACE] = sum;
    }
"""
_SUM_OF_GROUP = """
    barrier(CLK_LOCAL_MEM_FENCE);
    parts[get_local_id(0)] = total_NAME;
    for (int next = GROUP / 2; next; next /= 2) {
        barrier(CLK_LOCAL_MEM_FENCE);
        if (get_local_id(0) < next)
            parts[get_local_id(0)] += parts[get_local_id(0) + next];
    }
    if (!get_local_id(0))
        results[(size_t)OUTPUTS * capacity + SUMS * get_group_id(0) + PLACE] = parts[0];
"""


class GaussianKernel:
    """Numbers of each Gaussian, and sums over all, in one OpenCL kernel.

    The source is statements of OpenCL C 1.2 for some adjacent Gaussians at once: a `lane` has a number of
    each, and is a vector on a CPU and a number on a GPU. Arithmetic, comparison, `condition ? a : b` and
    `lane_exp`, `lane_log`, `lane_sqrt` and `lane_abs` mean the same for both; `if` on a lane does not.

    - Parameters, as `GaussianReader.read` names them, and tensors are lanes or, with several numbers for
      each Gaussian, arrays of lanes: `means[0]`. The gradient of `name` is `d_name`. Masks hold 0 or 1.
      Numbers are of the type `real`. In `#if`, `HAS_name` is 0 for a tensor that is None, else 1.
    - Set outputs, which are lanes, by their names, and sums to the Gaussian's share.

    Sums have a fixed order: equal inputs give equal bits on a device.

    Args:
        source: the statements.
        parameters: names of parameters that it reads.
        gradients: names of parameters whose gradients it reads.
        outputs: names of results for each Gaussian.
        sums: names of sums.
        helpers: macros and functions that the source uses.
        name: in errors.
    """

    def __init__(
        self,
        source: str,
        *,
        parameters: Collection[str] = (),
        gradients: Collection[str] = (),
        outputs: Collection[str] = (),
        sums: Collection[str] = (),
        helpers: str = "",
        name: str = "kernel",
    ) -> None:
        self._texts, self._name = (source, helpers, name), name
        self._parameters, self._gradients = tuple(parameters), tuple(gradients)
        self._outputs, self._sums = tuple(outputs), tuple(sums)
        self._words = frozenset(re.findall(r"\w+", source + helpers))

    def __call__(
        self, model: GaussianReader, **given: Tensor | float | None
    ) -> tuple[dict[str, Tensor], dict[str, float]]:
        """Run the kernel, and wait for it.

        Args:
            model: the Gaussians.
            given: inputs by name: tensors `[N]` or `[N, C]`, numbers, or None.

        Returns:
            The outputs `[N]` and the sums, by name.

        Raises:
            ExplainedError: an input that the source does not name, or of another size.
            DeviceError: the compiler rejects the source.
        """
        rows, numbers = dict[str, _Rows](), dict[str, float]()
        for name in self._parameters:
            rows[name] = self._stored(model, name, gradient=False)
        for name in self._gradients:
            rows[f"d_{name}"] = self._stored(model, name, gradient=True)
        for name, value in given.items():
            if not self._words & {name, f"HAS_{name}"}:
                what = f"the source does not name the input {name!r}"
                raise self._refused(what, "correct the name, or leave the input out")
            if isinstance(value, Tensor):
                if value.ndim not in (1, 2) or len(value) != model.count:
                    shape, count = tuple(value.shape), model.count
                    raise self._refused(
                        f"the input {name!r} is {shape}; there are {count} Gaussians",
                        f"pass [{count}] or [{count}, C]",
                    )
                rows[name] = _sent(model, value)
            elif value is not None:
                numbers[name] = float(value)
        there = tuple((name, value is not None) for name, value in given.items())
        return self._run(model, rows, numbers, there)

    def _run(
        self,
        model: GaussianReader,
        rows: Mapping[str, _Rows],
        numbers: Mapping[str, float],
        there: tuple[tuple[str, bool], ...],
    ) -> tuple[dict[str, Tensor], dict[str, float]]:
        device, count, capacity = model.device, model.count, padded(model.count)
        lanes, on_cpu = device.lanes, device.variant == "cpu"
        items = max(1, -(-count // lanes))
        span = -(-items // CHUNKS) if on_cpu else 1
        local = 1 if on_cpu else GROUP
        groups = -(-items // (span * local))
        widths = tuple((name, given.width) for name, given in rows.items())
        text = _kernel(
            *self._texts, widths, tuple(numbers), there, self._outputs, self._sums, on_cpu
        )
        program = device.program(text, dtype=torch.float32)
        values = len(self._outputs) * capacity  # before the sums, so that one read is enough
        with device.lock:
            elements = max(1, values + groups * len(self._sums))
            results = DeviceArray.for_results(device, elements, torch.float32)
            program.run(
                "gaussians",
                (groups * local,),
                (local,),
                **{f"p_{name}": given.array for name, given in rows.items()},
                **{f"first_{name}": given.first for name, given in rows.items()},
                **numbers,
                results=results,
                count=count,
                capacity=capacity,
                span=span,
            )
            found = results.read()
        outputs = found[:values].reshape(-1, capacity)[:, :count].unbind()
        totals = found[values:].reshape(groups, -1).sum(dim=0, dtype=torch.float64).tolist()
        return (
            dict(zip(self._outputs, outputs, strict=True)),
            dict(zip(self._sums, totals, strict=True)) if self._sums else {},
        )

    def _stored(self, model: GaussianReader, name: str, *, gradient: bool) -> _Rows:
        """A parameter or its gradient, on the device if it is there."""
        there = model._device_rows(name, gradient=gradient)
        if there is None:
            return _sent(model, model.gradient(name) if gradient else model.read(name))
        array, first, last = there
        return _Rows(array, first, last - first)

    def _refused(self, what: str, fix: str) -> ExplainedError:
        return ExplainedError(what, where=f"call of the GaussianKernel {self._name!r}", fix=fix)


class _Rows(NamedTuple):
    """`width` rows of an array `[rows, capacity]`, from `first` on."""

    array: DeviceArray
    first: int
    width: int


def _sent(model: GaussianReader, values: Tensor) -> _Rows:
    """Send numbers of the Gaussians as rows."""
    values = values.detach().reshape(model.count, -1)
    rows = torch.empty(values.shape[1], padded(model.count))
    rows[:, model.count :] = 0
    # torch takes twenty times as long as numpy to copy a transposed array.
    rows.numpy()[:, : model.count] = values.numpy().T
    return _Rows(DeviceArray.holding(model.device, rows), 0, values.shape[1])


@lru_cache
def _kernel(
    source: str,
    helpers: str,
    name: str,
    rows: tuple[tuple[str, int], ...],
    numbers: tuple[str, ...],
    given: tuple[tuple[str, bool], ...],
    outputs: tuple[str, ...],
    sums: tuple[str, ...],
    on_cpu: bool,
) -> KernelText:
    """The kernel `gaussians`: loads lanes, runs the statements, stores the outputs and adds up the sums."""
    arguments = [f"__global const real *p_{title}" for title, _ in rows]
    arguments += [f"int first_{title}" for title, _ in rows]
    arguments += [f"real {title}" for title in numbers]
    arguments += ["__global real *results", "int count", "int capacity", "int span"]
    loads = []
    for title, width in rows:
        values = [
            f"LOAD_GLOBAL(p_{title} + (size_t)(first_{title} + {k}) * capacity + i)"
            for k in range(width)
        ]
        loads.append(
            f"const lane {title} = {values[0]};"
            if width == 1
            else f"const lane {title}[{width}] = {{{', '.join(values)}}};"
        )
    loads += [f"lane {title} = 0;" for title in (*outputs, *sums)]
    stores = [
        f"STORE_GLOBAL(results + (size_t){k} * capacity + i, {title});"
        for k, title in enumerate(outputs)
    ]
    inside = [
        "if (i + LANES > count)",
        "for (int l = count - i; l < LANES; l++) {",
        *(f"LANE_AT({title}, l) = 0;" for title in sums),
        "}",
        *(f"total_{title} += {title};" for title in sums),
    ]
    body = "\n".join([*loads, "#line 1", source, *stores, *(inside if sums else [])])
    ending = "".join(
        (_SUM_OF_LANES if on_cpu else _SUM_OF_GROUP)
        .replace("NAME", title)
        .replace("PLACE", str(place))
        for place, title in enumerate(sums)
    )
    lines = [
        *(f"#define HAS_{title} {int(is_there)}" for title, is_there in given),
        helpers,
        f"#define GROUP {GROUP}",
        f"#define OUTPUTS {len(outputs)}",
        f"#define SUMS {len(sums)}",
        f"__kernel void gaussians({', '.join(arguments)})\n{{",
        "" if on_cpu or not sums else "    __local real parts[GROUP];",
        *(f"    lane total_{title} = 0;" for title in sums),
        (_CHUNK if on_cpu else _ITEM).replace("BODY", body),
        ending,
        "}",
    ]
    return KernelText(name, "\n".join(lines))
