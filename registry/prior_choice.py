"""Which of a pipeline's priors a component means."""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING, Any, TypeVar

from .errors import PluginError

if TYPE_CHECKING:
    from .components import Prior

PriorType = TypeVar("PriorType", bound="Prior[Any]")


def choose_prior(
    priors: Mapping[str, Prior[Any]], wanted: type[PriorType], name: str | None
) -> PriorType:
    """See `Prior.choose`, which asks for its own class."""
    able = {key: prior for key, prior in priors.items() if isinstance(prior, wanted)}
    listed = ", ".join(f"{key} ({prior.capability})" for key, prior in priors.items()) or "none"
    if name is not None:
        if name in able:
            return able[name]
        what = (
            f"the prior {name!r} has the capability {priors[name].capability!r}"
            if name in priors
            else f"there is no prior named {name!r}"
        )
        raise PluginError(
            f"{what}; {wanted.capability!r} is needed",
            fix=f"name one that has it; the pipeline's priors are: {listed}",
        )
    if len(able) == 1:
        return next(iter(able.values()))
    if able:
        raise PluginError(
            f"{len(able)} priors have the capability {wanted.capability!r}",
            fix=f"choose with `prior: NAME`, one of {', '.join(able)}",
        )
    raise PluginError(
        f"a prior with the capability {wanted.capability!r} is needed, and the pipeline has none",
        fix=f"add one under `priors:`; `stereogs plugins` lists them (the pipeline's: {listed})",
    )
