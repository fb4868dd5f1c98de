"""All formats that something reads, by name."""

from __future__ import annotations

from tests.fuzzing.formats.arrays_and_models import Checkpoints, OnnxFiles, PriorAnswers
from tests.fuzzing.formats.images import Images
from tests.fuzzing.formats.points import PointFiles
from tests.fuzzing.formats.scenes import SCENES
from tests.fuzzing.formats.texts import PipelineFiles, ResultsFiles
from tests.fuzzing.target import Target

_ALL: tuple[type[Target], ...] = (
    *SCENES,
    Images,
    PointFiles,
    PipelineFiles,
    ResultsFiles,
    Checkpoints,
    PriorAnswers,
    OnnxFiles,
)
TARGETS = {target.name: target for target in _ALL}
