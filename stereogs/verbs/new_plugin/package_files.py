"""The files of a new plugin package, filled in from the templates beside this file."""

from __future__ import annotations

import re
from collections.abc import Iterator, Mapping
from importlib import resources
from pathlib import Path
from string import Template

from registry import API_VERSION, PluginError
from registry.contract.hook_points import HOOK_POINTS, HookPoint
from registry.discovery import GROUP, installed_entries, offered_name
from registry.messages.suggestions import did_you_mean, listing
from registry.system.files import new_folder

from ...command_line.installed import COMMANDS, verbs

COMPONENTS: Mapping[str, HookPoint] = {
    point.section.removesuffix("s"): point for point in HOOK_POINTS if point.in_pipeline
}
"""Kinds of component: the sections of a pipeline, in the singular."""
COMMAND = "command"
KINDS = (*COMPONENTS, COMMAND)
PRIOR = "prior"
OWN = "own"
CAPABILITIES = (
    *("stereo_disparity", "monocular_depth", "multi_view_depth", "posed_depth", "normals", "masks"),
    *("gaussians", "optical_flow", "matches", OWN),
)
"""What a prior estimates, the usual one first; `own` is a capability that only its package knows."""

_NAME = re.compile(r"[a-z][a-z0-9_-]*")
_TEMPLATES = resources.files("stereogs.verbs.new_plugin").joinpath("templates")


def new_plugin(name: str, kind: str, parent: Path, capability: str | None = None) -> Path:
    """Write the package `stereogs-NAME`: plugin, entry point, test, README, and a component's pipeline.

    Args:
        name: name of the component in pipelines, or of the command.
        kind: one of `KINDS`.
        parent: folder in which the package's folder is created; created if missing.
        capability: of a prior, one of `CAPABILITIES`; None: the first one.

    Returns:
        The package's folder.

    Raises:
        PluginError: the name, kind or capability is invalid, an installed plugin offers the name, or the
            folder exists and is not empty.
    """
    _check(name, kind, capability)
    template = f"{PRIOR}_{capability or CAPABILITIES[0]}" if kind == PRIOR else kind
    call = ", call=lambda prior, scene: prior.sharpness(scene.train[0].image)"
    words = {**_words(name, kind), "call": call if capability == OWN else ""}
    folder = parent / words["distribution"]
    if folder.exists() and (not folder.is_dir() or any(folder.iterdir())):
        what, fix = "folder exists and is not empty", "choose another name, or --into"
        raise PluginError(what, where=str(folder), fix=fix)
    with new_folder(folder) as temporary:
        for file, text in _files(template, words):
            (temporary / file).write_text(text, "utf-8")
    return folder


def _files(template: str, words: Mapping[str, str]) -> Iterator[tuple[str, str]]:
    body = _filled(f"kinds/{template}.py", words).rstrip("\n")
    suffix = "_command" if template == COMMAND else ""
    yield "pyproject.toml", _filled("package/pyproject.toml", words)
    yield f"{words['module']}.py", _filled("package/plugin.py", {**words, "body": body})
    yield "README.md", _filled(f"package/README{suffix}.md", words)
    yield f"test_{words['module']}.py", _filled(f"package/test{suffix}.py", words)
    if template != COMMAND:
        yield "pipeline.yaml", _pipeline(template, words)


def _check(name: str, kind: str, capability: str | None) -> None:
    if kind not in KINDS:
        raise PluginError(
            f"unknown kind of plugin {kind!r}{did_you_mean(kind, KINDS)}",
            where="--kind",
            fix=f"kinds: {listing(KINDS)}",
        )
    if capability is not None and (kind != PRIOR or capability not in CAPABILITIES):
        what = f"unknown capability {capability!r}{did_you_mean(capability, CAPABILITIES)}"
        raise PluginError(
            what if kind == PRIOR else f"a {kind} has no capability",
            where="--capability",
            fix=f"use --kind {PRIOR}; capabilities: {listing(CAPABILITIES)}",
        )
    if not _NAME.fullmatch(name):
        raise PluginError(
            f"{name!r} is not a valid name",
            where="NAME",
            fix="use lower-case letters, digits, '-' and '_', a letter first",
        )
    noun, installed = "component", {offered_name(entry): entry for entry in installed_entries()}
    if kind == COMMAND:
        noun, installed = "command", {name: verb.entry for name, verb in verbs().items()}
    if name in installed:
        package = installed[name].dist
        raise PluginError(
            f"a {noun} {name!r} is installed, offered by {package.name if package else 'stereogs'}",
            where="NAME",
            fix="choose another name: a name that two packages offer cannot be used",
        )


def _words(name: str, kind: str) -> dict[str, str]:
    """Return the values of the templates' placeholders."""
    parts = [part for part in re.split(r"[-_]+", name) if part]
    if kind == COMMAND:
        title, hook, group = "Command", "stereogs_register_commands", COMMANDS
        summary = "Print the number of files in a folder."
    else:
        title, hook, group = COMPONENTS[kind].title.capitalize(), COMPONENTS[kind].hook, GROUP
        summary = f"{title} `{name}`."
    return {
        "name": name,
        "kind": kind,
        "distribution": "stereogs-" + "-".join(parts),
        "module": "stereogs_" + "_".join(parts),
        "class_name": "".join(part.capitalize() for part in [*parts, kind]),
        "api": str(API_VERSION),
        "title": title,
        "hook": hook,
        "group": group,
        "summary": summary,
    }


def _pipeline(template: str, words: Mapping[str, str]) -> str:
    """Return the pipeline of all packages, with the sections of this template replaced."""
    own = _filled(f"kinds/{template}.yaml", words).splitlines()
    keys = {line.partition(":")[0] for line in own if line[:1].isalpha()}
    usual = _filled("package/pipeline.yaml", words).splitlines()
    return "\n".join([*(x for x in usual if x.partition(":")[0] not in keys), *own, ""])


def _filled(path: str, words: Mapping[str, str]) -> str:
    text = _TEMPLATES.joinpath(f"{path}.template").read_text("utf-8")
    return Template(text).substitute(words)
