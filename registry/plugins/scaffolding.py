"""A new plugin package, complete: written from the templates in data/new_plugin."""

from __future__ import annotations

import re
from collections.abc import Mapping
from importlib import resources
from pathlib import Path
from string import Template

from ..contract.hook_points import API_VERSION, PIPELINE_POINTS, HookPoint
from ..errors import PluginError
from ..messages.suggestions import did_you_mean, listing
from ..system.files import new_folder
from .discovery import installed_entries, offered_name

KINDS: Mapping[str, HookPoint] = {
    point.section.removesuffix("s"): point for point in PIPELINE_POINTS
}
"""What a package can be written for: the sections of a pipeline, in the singular."""

_NAME = re.compile(r"[a-z][a-z0-9_-]*")
_TEMPLATES = resources.files("registry").joinpath("data", "new_plugin")


def new_plugin(name: str, kind: str, parent: Path) -> Path:
    """Write the package `stereogs-NAME`: plugin, entry point, test, pipeline and README.

    Args:
        name: of the component, as pipelines will write it.
        kind: one of `KINDS`.
        parent: the folder that it goes into; created if need be.

    Returns:
        Its folder.

    Raises:
        PluginError: the name or the kind cannot be, an installed plugin offers the name, or the
            folder exists and is not empty.
    """
    _check(name, kind)
    words = _words(name, kind)
    folder = parent / words["distribution"]
    if folder.exists() and (not folder.is_dir() or any(folder.iterdir())):
        raise PluginError(
            "there is something already", where=str(folder), fix="choose another name, or --into"
        )
    body = _filled(f"kinds/{kind}.py", words).rstrip("\n")
    with new_folder(folder) as temporary:
        for file, text in {
            "pyproject.toml": _filled("package/pyproject.toml", words),
            "README.md": _filled("package/README.md", words),
            "pipeline.yaml": _pipeline(kind, words),
            f"{words['module']}.py": _filled("package/plugin.py", {**words, "body": body}),
            f"test_{words['module']}.py": _filled("package/test.py", words),
        }.items():
            (temporary / file).write_text(text, "utf-8")
    return folder


def _check(name: str, kind: str) -> None:
    if kind not in KINDS:
        raise PluginError(
            f"there is no kind {kind!r} of plugin{did_you_mean(kind, KINDS)}",
            where="--kind",
            fix=f"kinds: {listing(KINDS)}",
        )
    if not _NAME.fullmatch(name):
        raise PluginError(
            f"{name!r} is not a name that a component can have",
            where="NAME",
            fix="use lower-case letters, digits, '-' and '_', a letter first",
        )
    for entry in installed_entries():
        if offered_name(entry) == name:
            owner = entry.dist.name if entry.dist else "a package"
            raise PluginError(
                f"a component {name!r} is installed, offered by {owner}",
                where="NAME",
                fix="choose another name: what two packages offer no pipeline can use",
            )


def _words(name: str, kind: str) -> dict[str, str]:
    """What stands for the placeholders of the templates."""
    point = KINDS[kind]
    parts = [part for part in re.split(r"[-_]+", name) if part]
    class_name = "".join(part.capitalize() for part in [*parts, kind])
    return {
        "name": name,
        "distribution": "stereogs-" + "-".join(parts),
        "module": "stereogs_" + "_".join(parts),
        "class_name": class_name,
        "title": point.title.capitalize(),
        "hook": point.hook,
        "api": str(API_VERSION),
    }


def _pipeline(kind: str, words: Mapping[str, str]) -> str:
    """The pipeline that every package has, with the kind's own sections in place of its."""
    own = _filled(f"kinds/{kind}.yaml", words).splitlines()
    keys = {_key(line) for line in own} - {""}
    usual = _filled("package/pipeline.yaml", words).splitlines()
    kept = [line for line in usual if _key(line) not in keys]
    return "\n".join([*kept, *own, ""])


def _key(line: str) -> str:
    """The section that a line of a pipeline begins; empty if it begins none."""
    found = re.match(r"(\w+):", line)
    return found[1] if found else ""


def _filled(path: str, words: Mapping[str, str]) -> str:
    text = _TEMPLATES.joinpath(f"{path}.template").read_text("utf-8")
    return Template(text).substitute(words)
