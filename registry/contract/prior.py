"""Base class of prior models, and the choice among a pipeline's priors."""

from __future__ import annotations

from abc import ABC
from collections.abc import Mapping, Sequence
from typing import Any, ClassVar, Self

from ..errors import PluginError
from .component import Component, SettingsType


class Prior(Component[SettingsType], ABC):
    """A frozen model that estimates something from images.

    The subclasses `StereoPrior`, `MultiViewDepthPrior`, `MonocularDepthPrior`, `OpticalFlowPrior` and
    `MatchingPrior` have a fixed signature and checked estimates; plugins may agree on other capabilities.
    A component asks for a capability (`StereoPrior.choose`), the pipeline names the prior.

    Methods that components call work within `with self.context.at_work():`, so that errors name the prior,
    its package and its line in the pipeline.
    """

    capability: ClassVar[str]
    """What it estimates."""

    def fingerprint(self) -> str:
        """Return what estimates depend on besides settings and code: a model file's hash, a device."""
        return ""

    @classmethod
    def settings_for(cls, model: Any) -> Sequence[Mapping[str, Any]]:
        """Return candidate settings for an ONNX file, for `stereogs priors check`; the likeliest first.

        Each includes the file and consists of plain values. Options that the graph's names and sizes do not
        determine, such as the values of black and white, need a candidate for each possibility. Empty if
        this prior cannot run the model.

        Args:
            model: a `registry.OnnxModel`.
        """
        return ()

    @classmethod
    def choose(cls, priors: Mapping[str, Prior[Any]], name: str | None) -> Self:
        """Return the pipeline's prior of this class.

        Args:
            priors: the pipeline's priors by name.
            name: which one; None: the only one of this class.

        Raises:
            PluginError: no prior or several are of this class, or the named one does not exist or is of
                another class.
        """
        able = {key: prior for key, prior in priors.items() if isinstance(prior, cls)}
        if name in able:
            return able[name]
        if name is None and len(able) == 1:
            return next(iter(able.values()))
        wanted = repr(cls.capability)
        listed = ", ".join(f"{key} ({prior.capability})" for key, prior in priors.items()) or "none"
        if name is None and able:
            what = f"{len(able)} priors have the capability {wanted}"
            fix = f"choose with `prior: NAME`, one of {', '.join(able)}"
        elif name is None:
            what = f"a prior with the capability {wanted} is needed, and the pipeline has none"
            fix = (
                f"add one under `priors:`; `stereogs plugins` lists them (the pipeline's: {listed})"
            )
        elif name in priors:
            other = priors[name].capability
            what = f"the prior {name!r} has the capability {other!r}; {wanted} is needed"
            fix = f"name one that has it; the pipeline's priors are: {listed}"
        else:
            what = f"there is no prior named {name!r}; {wanted} is needed"
            fix = f"name one that has it; the pipeline's priors are: {listed}"
        raise PluginError(what, fix=fix)
