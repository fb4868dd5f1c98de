"""Ready pipelines, as files that any package may bring.

A package names an entry point in the group `stereogs.pipelines`; its value is the package in which the
files lie, `NAME.yaml`, or `FOLDER/NAME.yaml` for the name FOLDER/NAME.
"""

from __future__ import annotations

from importlib.metadata import entry_points
from importlib.util import find_spec
from pathlib import Path

from ..errors import PipelineError
from ..messages.suggestions import did_you_mean, listing

GROUP = "stereogs.pipelines"
_SUFFIXES = (".yaml", ".yml")


def is_pipeline_file(path: Path) -> bool:
    """Whether a path has the ending of a pipeline file and is no folder."""
    return path.suffix.lower() in _SUFFIXES and not path.is_dir()


def ready_pipelines() -> dict[str, tuple[Path, ...]]:
    """The files of each name, sorted by name; more than one if several packages bring it."""
    found: dict[str, tuple[Path, ...]] = {}
    for entry in entry_points(group=GROUP):
        spec = find_spec(entry.value)
        for folder in map(Path, (spec and spec.submodule_search_locations) or ()):
            for file in sorted([*folder.glob("*.yaml"), *folder.glob("*/*.yaml")]):
                name = file.relative_to(folder).with_suffix("").as_posix()
                if file not in found.get(name, ()):
                    found[name] = (*found.get(name, ()), file)
    return dict(sorted(found.items()))


def find_pipeline(given: Path) -> Path:
    """The file that is given, or the ready pipeline of that name; a file that is there comes first.

    Raises:
        PipelineError: there is no such name, or two packages bring it.
    """
    if given.is_file() or given.suffix.lower() in _SUFFIXES:
        return given
    name = given.as_posix()
    ready = ready_pipelines()
    files = ready.get(name, ())
    if len(files) == 1:
        return files[0]
    if files:
        raise PipelineError(
            f"the pipeline {name!r} is brought by several packages: {listing(map(str, files))}",
            where="the command line",
            fix="give the path of the file that is meant",
        )
    folders = {found.partition("/")[0]: None for found in ready if "/" in found}
    more = f"; more are in {listing(folders)}" if folders else ""
    raise PipelineError(
        f"there is no pipeline file and no ready pipeline {name!r}{did_you_mean(name, ready)}",
        where="the command line",
        fix="give the path of a YAML file (to train, also of a folder that is there), or one of: "
        f"{listing(found for found in ready if '/' not in found)}{more}",
    )
