"""Edits of the set of Gaussians, with the optimizer's moments."""

from __future__ import annotations

import torch
from torch import Tensor

from ..device import DeviceArray, Program
from ..errors import GaussianError
from ..gaussians import Gaussians
from ..layout import padded, rows_of
from ..raster import pack
from .adam import Adam
from .edit import Carried, Edit, Relocation
from .storage import GaussianStorage

_MAX_LOGIT = 16.0
"""Logits are clamped to it: the opacity is then 1 to seven digits, and the alternating sum of
`shared_among_copies` keeps nine."""


def apply_edit(
    model: GaussianStorage, optimizer: Adam, edit: Edit, generator: torch.Generator
) -> Carried:
    """Apply an edit to the parameters and the optimizer's moments.

    The order afterwards: Gaussians that stay, relocated ones included, in their old order; clones;
    children of splits; added ones. Moments are zero for new Gaussians and for the sources of relocations;
    gradients and densification statistics are reset. An invalid edit changes nothing.

    Args:
        generator: draws the children's offsets from N(0, covariance of the parent).

    Raises:
        GaussianError: the edit does not fit the Gaussians (`Edit.check`), adds ones of another SH
            degree, or removes all.
    """
    edit.check(model.count)
    added = edit.add if edit.add is not None and len(edit.add) else None
    if added is not None and added.sh_degree != model.sh_degree:
        raise GaussianError(
            f"the added Gaussians have SH degree {added.sh_degree}, the model has {model.sh_degree}",
            field="add",
        )
    plan = _Plan(edit, model.count)
    mover = _Mover(model, plan)
    parameters = mover.move(model.parameters)
    if edit.relocate is not None:
        _share(model, edit.relocate, plan, parameters)
    if plan.children:
        noise = torch.randn(plan.children, 3, generator=generator, dtype=torch.float64)
        mover.spread(parameters, noise, plan.first_child, edit.shrink)
    if added is not None:
        mover.append(parameters, added, plan.first_child + plan.children)
    moments = [
        mover.move(values, zero=plan.restarted)
        for values in (optimizer.first_moments, optimizer.second_moments)
    ]
    model.adopt(parameters, plan.count)
    optimizer.first_moments, optimizer.second_moments = moments
    return Carried(plan.source, plan.fresh)


class _Plan:
    """Origin of each Gaussian after an edit.

    Attributes:
        source, fresh: as in `Carried`.
        restarted: `[N_new]` bool, True where moments become zero.
        children, first_child: number of children of splits, and the index of the first.
    """

    def __init__(self, edit: Edit, count: int) -> None:
        origin, moved, restarted = torch.arange(count), *torch.zeros(2, count, dtype=torch.bool)
        if edit.relocate is not None:
            origin[edit.relocate.target] = edit.relocate.source
            moved[edit.relocate.target] = True
            restarted[edit.relocate.source] = True
        prune, split = edit.mask("prune", count), edit.mask("split", count)
        kept = (~(prune | split)).nonzero()[:, 0]
        cloned = edit.mask("clone", count).nonzero()[:, 0]
        children = split.nonzero()[:, 0].repeat(edit.split_into)
        parents = children[:0] if edit.parents is None else edit.parents
        self.source = torch.cat([origin[kept], origin[cloned], origin[children], parents])
        self.count, self.children = len(self.source), len(children)
        self.first_child = len(kept) + len(cloned)
        if not self.count:
            raise GaussianError(
                f"the edit would remove all {count} Gaussians",
                field="prune",
                fix="keep at least one, or stop the policy that removes them",
            )
        self.fresh = torch.ones(self.count, dtype=torch.bool)
        self.fresh[: len(kept)] = moved[kept]
        self.restarted = self.fresh.clone()
        self.restarted[: len(kept)] |= restarted[kept]


def _share(model: GaussianStorage, move: Relocation, plan: _Plan, parameters: DeviceArray) -> None:
    """Set the opacities and scales of relocation sources and their copies."""
    copies = 1 + torch.bincount(move.source, minlength=model.count)
    shared = (copies > 1).nonzero()[:, 0]
    logits, log_scales = (model.read(n).clone() for n in ("opacity_logits", "log_scales"))
    new_logits, log_factors = shared_among_copies(logits[shared], copies[shared])
    logits[shared] = new_logits.to(logits.dtype)
    log_scales[shared] += log_factors.to(logits.dtype)[:, None]
    for name, values in (("opacity_logits", logits), ("log_scales", log_scales)):
        first, last = rows_of(name, model.sh_degree)
        rows = torch.zeros(last - first, parameters.shape[1], dtype=logits.dtype)
        rows[:, : plan.count] = values[plan.source].reshape(plan.count, -1).T
        parameters.write(rows, first, last)


def shared_among_copies(opacity_logits: Tensor, copies: Tensor) -> tuple[Tensor, Tensor]:
    """Opacities and scales of n coinciding Gaussians that replace one (3DGS-MCMC, equation 9).

    Kheradmand et al. 2024: the opacity becomes o' = 1 - (1 - o)^(1/n), and all scales are multiplied by
    o / sum over i = 1..n and k = 0..i-1 of C(i-1, k) (-1)^k o'^(k+1) / sqrt(k + 1).

    Args:
        opacity_logits: `[M]`, of the Gaussian that is replaced.
        copies: `[M]` int64, n >= 1.

    Returns:
        The logit of o' `[M]`, and the logarithm of the factor of the scales `[M]`; both float64.
    """
    n = copies.double()
    logits = opacity_logits.double().clamp(-_MAX_LOGIT, _MAX_LOGIT)
    # ln(1 - o') is accurate for o near 0 and near 1.
    transparency = torch.nn.functional.logsigmoid(-logits) / n
    opacity = -torch.expm1(transparency)
    # The sum over i is C(0, k) + ... + C(n-1, k) = C(n, k+1), which leaves one sum over m = k + 1; its
    # terms are 0 for m > n.
    term, total = -torch.ones_like(n), torch.zeros_like(n)
    for m in range(1, int(copies.max()) + 1 if len(copies) else 1):
        term = term * -opacity * (n - m + 1) / m
        total = total + term / m**0.5
        if (term.abs() <= 1e-17 * total.abs()).all():
            break
    return opacity.log() - transparency, torch.log(torch.sigmoid(logits) / total)


class _Mover:
    """Gathers columns of device arrays by a plan, and initializes new ones."""

    def __init__(self, model: GaussianStorage, plan: _Plan) -> None:
        self._device, self._dtype = model.device, model.dtype
        self._group = model.device.profile.topology_group
        self._program: Program = model.device.program(
            "raster/scene", "optimization/topology", dtype=model.dtype, TOPOLOGY_GROUP=self._group
        )
        self._count, self._capacity = plan.count, padded(plan.count)
        self._source = self._array(plan.source, torch.int32)
        self._none = self._array(torch.zeros(plan.count), torch.int32)

    def move(self, values: DeviceArray, zero: Tensor | None = None) -> DeviceArray:
        """Return the gathered columns, with zeros where the mask `zero` `[N_new]` is set."""
        target = DeviceArray(self._device, (values.shape[0], self._capacity), self._dtype)
        self._run(
            "gather_columns",
            self._capacity,
            values=values,
            source=self._source,
            zero=self._none if zero is None else self._array(zero, torch.int32),
            target=target,
            count=self._count,
            capacity=values.shape[1],
            target_capacity=self._capacity,
            rows=values.shape[0],
        )
        return target

    def spread(self, parameters: DeviceArray, noise: Tensor, first: int, shrink: float) -> None:
        """Move the children, columns from `first` on, apart by standard normal noise."""
        self._run(
            "spread_children",
            noise.shape[0],
            parameters=parameters,
            noise=self._array(noise, self._dtype),
            first=first,
            children=noise.shape[0],
            capacity=self._capacity,
            shrink=shrink,
        )

    def append(self, parameters: DeviceArray, gaussians: Gaussians, first: int) -> None:
        """Write new Gaussians to the columns from `first` on."""
        rows = pack(gaussians, self._dtype, len(gaussians))
        self._run(
            "append_columns",
            len(gaussians),
            values=self._array(rows, self._dtype),
            target=parameters,
            first=first,
            columns=len(gaussians),
            target_capacity=self._capacity,
            rows=rows.shape[0],
        )

    def _array(self, values: Tensor, dtype: torch.dtype) -> DeviceArray:
        array = DeviceArray(self._device, tuple(values.shape), dtype)
        array.write(values)
        return array

    def _run(self, kernel: str, items: int, /, **arguments: DeviceArray | float) -> None:
        size = -(-items // self._group) * self._group
        self._program.run(kernel, (size,), (self._group,), **arguments)
        self._device.finish()
