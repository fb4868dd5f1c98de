"""Base class of prior models, and the choice among a pipeline's priors."""

from __future__ import annotations

import hashlib
from abc import ABC
from collections.abc import Mapping, Sequence
from functools import cache
from pathlib import Path
from typing import Any, ClassVar, Self

from ..errors import PluginError
from .component import Component, SettingsType


class Prior(Component[SettingsType], ABC):
    """A frozen model that estimates something from images.

    The subclasses in `registry.priors` have a fixed signature and checked estimates; plugins may agree on
    other capabilities. A component asks for a capability (`StereoPrior.choose`), the pipeline
    names the prior.

    Methods that components call work within `with self.context.at_work():`, so that errors name the prior,
    its package and its line in the pipeline.
    """

    capability: ClassVar[str]
    """Kind of estimate, such as "stereo_disparity"; components ask for it in `needs_priors`."""

    def fingerprint(self) -> str:
        """Return what estimates depend on besides settings and code: a model file's hash, a device.

        By default hashes of the files that settings of type `Path` name, and of models that are attributes or
        in a list or dictionary (`registry.toolkit.networks.OnnxModel`).
        """
        hashes = [
            _file_hash(value, value.stat().st_mtime_ns)
            for _, value in self.settings
            if isinstance(value, Path) and value.is_file()
        ]
        opened = []
        for own in vars(self).values():
            inside = own.values() if isinstance(own, dict) else own
            models = inside if isinstance(own, dict | list | tuple) else [own]
            opened += [getattr(model, "sha256", None) for model in models]
        return " ".join([*hashes, *(digest for digest in opened if isinstance(digest, str))])

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
        known = {key: prior.capability for key, prior in priors.items()}
        prior: Self = priors[chosen_prior(known, (cls.capability,), name)]  # type: ignore[assignment]
        return prior


@cache
def _file_hash(path: Path, modified: int) -> str:
    with path.open("rb") as file:
        return hashlib.file_digest(file, "sha256").hexdigest()


def chosen_prior(
    capabilities: Mapping[str, str | None], wanted: Sequence[str], name: str | None
) -> str:
    """Return the name of the prior that a component uses.

    Args:
        capabilities: of the pipeline's priors, by name.
        wanted: capabilities that the component can use, best first.
        name: which prior; None: the only one with the first capability that any prior has.

    Raises:
        PluginError: no prior or several can be used, or the named one does not exist or cannot.
    """
    needed = " or ".join(map(repr, wanted))
    listed = ", ".join(f"{key} ({own})" for key, own in capabilities.items()) or "none"
    if name is not None:
        if capabilities.get(name) in wanted:
            return name
        what = f"there is no prior named {name!r}"
        if name in capabilities:
            what = f"the prior {name!r} has the capability {capabilities[name]!r}"
        fix = f"name one that has it; the pipeline's priors are: {listed}"
        raise PluginError(f"{what}; {needed} is needed", fix=fix)
    able = usable_priors(capabilities, wanted)
    if len(able) == 1:
        return able[0]
    if able:
        what = f"{len(able)} priors have the capability {needed}"
        raise PluginError(what, fix=f"choose with `prior: NAME`, one of {', '.join(able)}")
    what = f"a prior with the capability {needed} is needed, and the pipeline has none"
    fix = f"add one under `priors:`; `stereogs plugins` lists them (the pipeline's: {listed})"
    raise PluginError(what, fix=fix)


def usable_priors(capabilities: Mapping[str, str | None], wanted: Sequence[str]) -> list[str]:
    """Return the priors with the first capability of `wanted` that any prior has."""
    for capability in wanted:
        if able := [name for name, own in capabilities.items() if own == capability]:
            return able
    return []
