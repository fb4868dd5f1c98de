"""Read a benchmark file and list its trials: entrants x scenes x seeds, the first seed several times.

protocol: llff-3                      or {use: llff-3, modified: [scene.downsample]}
scenes: [llff_fern, ./flower]         folders in STEREOGS_DATA, or paths with a slash
scene: {downsample: 16}               settings of the loader that the protocol leaves open or `modified` lists
entrants: [weightfree_quick, ./mine.yaml, opensplat]
budgets: [5, 10, 30, 60, 300]         seconds
seeds: 3                              0, 1, 2
repeats: 2                            trainings with seed 0
"""

from __future__ import annotations

import hashlib
import json
import os
from copy import deepcopy
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from pydantic import Field, PositiveFloat, model_validator

from registry import Settings
from registry.discovery import Plugins
from registry.errors import PipelineError
from registry.pipeline.pipeline import Pipeline
from registry.pipeline.ready import find_pipeline
from registry.pipeline.settings_check import escape_variables, validate_settings
from registry.pipeline.yaml_source import Node, Place, parse, read, to_yaml

from ...protocol_scene import loader_of
from ..planning.plan import changed_pipeline
from ..planning.variations import DATA, Change, is_path

PROGRAMS = Path(__file__).with_name("programs")
_EVALUATIONS = "training.evaluate_every"


class Program(Settings):
    """Another program. Commands run in an empty folder; `${NAME}` in them is a variable.

    {data} is the folder with the training views, {out} the folder to write, {seed} the seed. After the
    training, {cameras} is a folder with the test cameras and black photographs, and {renders} the folder for
    a PNG of each.
    """

    version: str = Field(min_length=1)
    """A command that prints the version."""
    train: str = Field(min_length=1)
    """The command that trains."""
    gaussians: str | None = None
    """Pattern of PLY files in {out}, in the coordinates of {data}."""
    render: str | None = None
    """A command that renders {cameras}, instead of `gaussians`."""
    layout: str = Field(pattern="^(colmap|transforms)$")
    """Layout of {data}."""
    points: dict[str, Any]
    """The initializer whose points {data} contains, as in a pipeline; its time does not count."""
    repeat_first: bool
    """Whether {data} has the first photograph twice, for programs that always hold it out."""
    timeout: PositiveFloat
    """Seconds after which the program is killed."""

    @model_validator(mode="after")
    def _one_output(self) -> Program:
        if (self.gaussians is None) == (self.render is None):
            raise ValueError("give either `gaussians` or `render`")
        return self


class BenchmarkFile(Settings):
    """The keys of a benchmark file, without defaults for what scores depend on."""

    protocol: str | dict[str, Any]
    scenes: tuple[str, ...] = Field(min_length=1)
    entrants: tuple[str, ...] = Field(min_length=1)
    budgets: tuple[PositiveFloat, ...] = Field(min_length=1)
    seeds: int = Field(ge=1)
    repeats: int = Field(ge=1)
    scene: dict[str, Any] = Field(default_factory=dict)


@dataclass(frozen=True, eq=False)
class Trial:
    """One training of an entrant.

    Args:
        entrant, scene, seed: what trains where.
        repeat: number of the training among those of equal seed, from 0.
        pipeline: what trains; for a program its protocol, scene, points and metrics.
        program: the other program, or None.
        budgets: seconds.
    """

    entrant: str
    scene: str
    seed: int
    repeat: int
    pipeline: Pipeline
    program: Program | None
    budgets: tuple[float, ...]

    @property
    def asked(self) -> dict[str, Any]:
        """Everything that the result depends on, as JSON values."""
        program = None if self.program is None else self.program.model_dump(mode="json")
        return {
            "pipeline": self.pipeline.to_yaml(),
            "seed": self.seed,
            "program": program,
            "budgets": list(self.budgets),
        }

    @property
    def name(self) -> str:
        """Name of its folder; the end identifies what was asked."""
        digest = hashlib.sha256(json.dumps(self.asked).encode()).hexdigest()[:10]
        return f"{self.entrant}_{self.scene}_seed-{self.seed}_{self.repeat}_{digest}"


@dataclass(frozen=True, eq=False)
class Benchmark:
    """A benchmark file with its trials; the first entrant is the one that differences refer to."""

    name: str
    protocol: str
    entrants: tuple[str, ...]
    scenes: tuple[str, ...]
    seeds: int
    repeats: int
    budgets: tuple[float, ...]
    trials: tuple[Trial, ...]


def read_benchmark(path: Path, plugins: Plugins) -> Benchmark:
    """Read a benchmark file, and check every trial before anything runs.

    Raises:
        PipelineError: a key is missing, unknown or wrong; an entrant or protocol is unknown; an entrant
            contradicts the protocol, or lacks the file of a prior; or names repeat.
        SceneError: no loader of the protocol reads a scene's folder.
    """
    root = read(path)
    file = validate_settings(BenchmarkFile, root, "the benchmark")
    budgets = tuple(sorted({*file.budgets}))
    entrants = {Path(name).stem: _entrant(name, path.parent) for name in file.entrants}
    folders = {Path(name).name: _scene_folder(name, root.place) for name in file.scenes}
    for key, found in (("entrants", entrants), ("scenes", folders)):
        if len(found) < len(getattr(file, key)):
            raise root.place.error(f"two {key} have one name", fix="rename the file or folder")
    written = file.protocol if isinstance(file.protocol, str) else file.protocol.get("use", "")
    trials = []
    for name, entrant in entrants.items():
        for scene, folder in folders.items():
            loader = {"use": loader_of(str(written), folder), "path": escape_variables(str(folder))}
            changes = [
                _change("protocol", file.protocol, path),
                _change("scene", {**loader, **file.scene}, path),
                _change(_EVALUATIONS, 0, path),  # scores during training would take time
            ]
            for seed in range(file.seeds):
                pipeline = changed_pipeline(_tree(name, entrant), changes, seed, plugins)
                _refuse_replaced_priors(name, pipeline)
                program = entrant if isinstance(entrant, Program) else None
                trials += [
                    Trial(name, scene, seed, repeat, pipeline, program, budgets)
                    for repeat in range(1 if seed else file.repeats)
                ]
    protocol = trials[0].pipeline.protocol
    assert protocol is not None
    departures = {**protocol.modified, **{f"scene.{key}": v for key, v in file.scene.items()}}
    title = ", ".join([protocol.protocol.name, *(f"{k}={v}" for k, v in departures.items())])
    return Benchmark(
        path.stem,
        title,
        (*entrants,),
        (*folders,),
        file.seeds,
        file.repeats,
        budgets,
        tuple(trials),
    )


def _refuse_replaced_priors(name: str, pipeline: Pipeline) -> None:
    replaced = [item.fallback for item in pipeline.items["priors"] if item.fallback]
    if replaced:
        raise PipelineError(
            f"another configuration would be trained than was asked for: the prior {replaced[0]}",
            where=f"the entrant {name}",
            fix="obtain the file (`stereogs models`), or enter a pipeline that names the other prior",
        )


def _change(path: str, value: Any, file: Path) -> Change:
    return Change(path, parse(to_yaml(value), str(file)))


def _entrant(name: str, folder: Path) -> Node | Program:
    """Return the tree of a pipeline, or a program: a file with the key `train`, or one of `programs/`."""
    known = PROGRAMS / f"{name}.yaml"
    file = folder / name
    if not file.is_file():
        file = known if known.is_file() else find_pipeline(Path(name))
    root = read(file)
    if isinstance(root.content, dict) and "train" in root.content:
        return validate_settings(Program, root, "the program")
    return root


def _tree(name: str, entrant: Node | Program) -> Node:
    if not isinstance(entrant, Program):
        return deepcopy(entrant)
    place = f"the program {name}"
    return parse(to_yaml({"name": name, "initializer": entrant.points}), place)


def _scene_folder(name: str, place: Place) -> Path:
    if is_path(name):
        return Path(name).expanduser()
    root = os.environ.get(DATA)
    if not root:
        fix = f"set {DATA}, or write a path with a slash"
        raise place.error(f"the scene {name!r} is a folder in {DATA}, which is not set", fix=fix)
    return Path(root, name)
