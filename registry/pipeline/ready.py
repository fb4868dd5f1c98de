"""Pipelines and protocols as files that any package may provide.

The value of an entry point in the group is the package that holds the files: `NAME.yaml`, or
`FOLDER/NAME.yaml` for the name FOLDER/NAME.
"""

from __future__ import annotations

from collections.abc import Mapping
from functools import cache
from importlib.metadata import entry_points
from importlib.util import find_spec
from pathlib import Path
from types import MappingProxyType

from ..messages.suggestions import did_you_mean, listing
from .yaml_source import Place

PIPELINES, PROTOCOLS = "stereogs.pipelines", "stereogs.protocols"
"""The entry-point groups."""
_SUFFIXES = (".yaml", ".yml")


def is_pipeline_file(path: Path) -> bool:
    """Return whether a path has the suffix of a pipeline file and is not a folder."""
    return path.suffix.lower() in _SUFFIXES and not path.is_dir()


@cache
def packaged_files(group: str) -> Mapping[str, tuple[Path, ...]]:
    """Return the files of each name, sorted by name; read once per process."""
    found: dict[str, tuple[Path, ...]] = {}
    for entry in entry_points(group=group):
        spec = find_spec(entry.value)
        for folder in map(Path, (spec and spec.submodule_search_locations) or ()):
            for file in sorted([*folder.glob("*.yaml"), *folder.glob("*/*.yaml")]):
                name = file.relative_to(folder).with_suffix("").as_posix()
                if file not in found.get(name, ()):
                    found[name] = (*found.get(name, ()), file)
    return MappingProxyType(dict(sorted(found.items())))


def ready_pipelines() -> Mapping[str, tuple[Path, ...]]:
    """Return the files of each ready pipeline, by name."""
    return packaged_files(PIPELINES)


@cache
def packager(source: str) -> str | None:
    """Return the package that provides a ready pipeline or protocol; None for other files and options."""
    file = Path(source).resolve()
    if file.suffix not in _SUFFIXES:
        return None
    installed = entry_points()  # reads the metadata of all packages
    for entry in (*installed.select(group=PIPELINES), *installed.select(group=PROTOCOLS)):
        spec = find_spec(entry.value) if entry.dist else None
        folders = (spec and spec.submodule_search_locations) or ()
        if entry.dist and any(Path(folder).resolve() in file.parents for folder in folders):
            return str(entry.dist.name)
    return None


def only_file(what: str, files: tuple[Path, ...], place: Place, fix: str) -> Path:
    """Return the single file of a name; raise a PipelineError if several packages provide it."""
    if len(files) > 1:
        files_listed = listing(map(str, files))
        raise place.error(f"{what} is provided by several packages: {files_listed}", fix)
    return files[0]


def find_pipeline(given: Path) -> Path:
    """Return the given file, or the file of the ready pipeline of that name; an existing file wins.

    Raises:
        PipelineError: the name is unknown, or several packages provide it.
    """
    if given.is_file() or given.suffix.lower() in _SUFFIXES:
        return given
    name, place = given.as_posix(), Place("the command line")
    ready = ready_pipelines()
    if name in ready:
        fix = "give the path of one of them"
        return only_file(f"the pipeline {name!r}", ready[name], place, fix)
    folders = {found.partition("/")[0]: None for found in ready if "/" in found}
    more = f"; more are in {listing(folders)}" if folders else ""
    raise place.error(
        f"found neither a pipeline file nor a ready pipeline {name!r}{did_you_mean(name, ready)}",
        fix="give the path of a YAML file (to train, also of an existing folder), or one of: "
        f"{listing(found for found in ready if '/' not in found)}{more}",
    )
