"""Interface of a planned training."""

from __future__ import annotations

import hashlib
import json
from typing import Any, Protocol, TypeVar

from registry.pipeline.pipeline import Pipeline
from registry.pipeline.yaml_source import Node


class PlannedTraining(Protocol):
    """A training of a campaign (`benchmarks.campaigns`)."""

    @property
    def name(self) -> str:
        """Name of its record and of its folder of outputs."""
        ...

    @property
    def identity(self) -> dict[str, Any]:
        """Its description in a record, plain JSON values."""
        ...

    @property
    def pipeline(self) -> Pipeline:
        """The pipeline to train."""
        ...

    @property
    def without(self) -> tuple[str, ...]:
        """Metrics of its protocol to leave out."""
        ...

    @property
    def digest(self) -> str:
        """Digest of the pipeline, independent of the location of the data."""
        ...


Planned = TypeVar("Planned", bound=PlannedTraining)


def written_digest(tree: Node) -> str:
    """Return ten hexadecimal digits that depend on all that is written in a pipeline, except `fallbacks`.

    A campaign does not train with a fallback (`benchmarks.campaign`).
    """
    written = tree.as_written()
    for prior in written.get("priors") or []:
        if isinstance(prior, dict):
            prior.pop("fallbacks", None)
    text = json.dumps(written, sort_keys=True)
    return hashlib.sha256(text.encode()).hexdigest()[:10]
