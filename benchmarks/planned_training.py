"""What a training that is measured must say of itself."""

from __future__ import annotations

import hashlib
import json
from typing import Any, Protocol, TypeVar

from registry.pipeline import Node, Pipeline


class PlannedTraining(Protocol):
    """A training of `benchmarks.methods` or `benchmarks.results`."""

    @property
    def name(self) -> str:
        """Of its files."""
        ...

    @property
    def identity(self) -> dict[str, Any]:
        """What a record says of it, plain JSON values."""
        ...

    @property
    def pipeline(self) -> Pipeline:
        """What is trained."""
        ...

    @property
    def without(self) -> tuple[str, ...]:
        """Metrics of its protocol that are not measured."""
        ...

    @property
    def digest(self) -> str:
        """Of the pipeline as it is written, the same wherever the data lie."""
        ...


Planned = TypeVar("Planned", bound=PlannedTraining)


def written_digest(tree: Node) -> str:
    """Ten hexadecimal digits that change with anything that is written in a pipeline."""
    text = json.dumps(tree.as_written(), sort_keys=True)
    return hashlib.sha256(text.encode()).hexdigest()[:10]
