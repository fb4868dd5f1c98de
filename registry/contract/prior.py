"""Prior models, and which of a pipeline's priors a component means."""

from __future__ import annotations

from abc import ABC
from collections.abc import Mapping, Sequence
from typing import Any, ClassVar, Self, TypeVar

from ..errors import PluginError
from .component import Component, SettingsType


class Prior(Component[SettingsType], ABC):
    """A frozen model that estimates something from images.

    `capability` says what. Those with a base class have a fixed question and checked answers:
    `StereoPrior`, `MultiViewDepthPrior`, `MonocularDepthPrior`, `OpticalFlowPrior` and `MatchingPrior`;
    any other text is free for plugins that agree on it. A consumer asks for a capability
    (`StereoPrior.choose`), the pipeline names the prior.

    What consumers call does its work within `with self.context.at_work():`, so that a failure names the
    prior, its package and its line in the pipeline.
    """

    capability: ClassVar[str]

    def fingerprint(self) -> str:
        """What answers depend on beside settings and code: a model file's hash, a device."""
        return ""

    @classmethod
    def settings_for(cls, model: Any) -> Sequence[Mapping[str, Any]]:
        """Settings with which this prior might run an ONNX file; `stereogs priors check` tries them.

        Each with the file itself, as plain values that a pipeline could hold, the likeliest first. What
        the graph's names and sizes cannot tell, such as the numbers for black and white, is left to
        trial: one entry for each possibility. Empty: the file has not the form of this prior's models.

        Args:
            model: a `registry.OnnxModel`.
        """
        return ()

    @classmethod
    def choose(cls, priors: Mapping[str, Prior[Any]], name: str | None) -> Self:
        """The pipeline's prior of this class.

        Args:
            priors: by name, as a component is given them.
            name: which one, or None: the only one of this class.

        Raises:
            PluginError: there is none, more than one, none of that name, or one of another class.
        """
        return _choose(priors, cls, name)


PriorType = TypeVar("PriorType", bound=Prior[Any])


def _choose(
    priors: Mapping[str, Prior[Any]], wanted: type[PriorType], name: str | None
) -> PriorType:
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
