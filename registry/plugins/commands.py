"""Verbs and train options: listed by their entry points, imported when they are used."""

from __future__ import annotations

import ast
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from importlib.machinery import PathFinder
from importlib.metadata import EntryPoint, entry_points
from importlib.util import find_spec
from typing import Any, TypeVar

from ..contract.command import Command, TrainOption
from ..errors import PluginError
from ..messages.suggestions import did_you_mean, listing

Kind = TypeVar("Kind", Command, TrainOption)

COMMANDS, TRAIN_OPTIONS = "stereogs.commands", "stereogs.train_options"
"""Entry-point groups. An entry is named after the verb or option that its module registers."""
_BUILT_IN = {
    "train": "running:Train",
    "resume": "running:Resume",
    "eval": "running:Eval",
    "explain": "inspecting:Explain",
    "plugins": "inspecting:Plugins",
    "schema": "inspecting:Schema",
    "doctor": "inspecting:Doctor",
}
"""The host's own verbs, and their classes in `registry.commands`."""


@dataclass(frozen=True)
class Verb:
    """A verb of the command line, not imported yet.

    Args:
        name: as the user types it.
        entry: its entry point; built-in verbs have one without a package.
    """

    name: str
    entry: EntryPoint

    @property
    def owner(self) -> str:
        """The package that offers it, and its version."""
        return _owner(self.entry)

    @property
    def summary(self) -> str:
        """First line of the docstring, read without importing the module; "" if there is none.

        Of the module, or for the host's own verbs of the class.
        """
        module = ast.parse(_source(self.entry.module) or "")
        classes = {node.name: node for node in module.body if isinstance(node, ast.ClassDef)}
        text = ast.get_docstring(classes.get(self.entry.attr, module))
        line = (text or "").partition("\n")[0].rstrip(".")
        return line[:1].lower() + line[1:]

    def load(self) -> Command:
        """Import the module and build the command.

        Raises:
            PluginError: the module cannot be imported or does not register the verb.
        """
        if self.entry.dist is None and self.entry.group == "":
            command: Command = self.entry.load()()
            return command
        return _registered(self.entry, "stereogs_register_commands", Command)  # type: ignore[type-abstract]


def verbs() -> dict[str, Verb]:
    """All verbs by name, the host's own first.

    Raises:
        PluginError: two packages offer a verb of the same name.
    """
    found = {
        name: Verb(name, EntryPoint(name, f"registry.commands.{value}", ""))
        for name, value in _BUILT_IN.items()
    }
    for entry in sorted(entry_points(group=COMMANDS), key=lambda entry: entry.name):
        if entry.name in found:
            raise PluginError(
                f"the verb {entry.name!r} is offered twice: by {found[entry.name].owner} and "
                f"{_owner(entry)}",
                fix="uninstall one of them",
            )
        found[entry.name] = Verb(entry.name, entry)
    return found


def train_options(verb: str) -> Sequence[TrainOption]:
    """The options that plugins add to a verb, by name.

    Raises:
        PluginError: one cannot be imported or does not register itself.
    """
    entries = sorted(entry_points(group=TRAIN_OPTIONS), key=lambda entry: entry.name)
    options = [_option(entry) for entry in entries]
    return [option for option in options if verb in option.verbs]


def _option(entry: EntryPoint) -> TrainOption:
    return _registered(entry, "stereogs_register_train_options", TrainOption)  # type: ignore[type-abstract]


def _registered(entry: EntryPoint, hook: str, kind: type[Kind]) -> Kind:
    """An instance of the class that the entry's module registers under the entry's name."""
    where = f"entry point {entry.group}: {entry.name} = {entry.value}"
    fix = f"update {_owner(entry)}, or uninstall it"
    try:
        module = entry.load()
    except Exception as error:  # the module of a third party may raise anything
        raise PluginError(
            f"{entry.name!r} of {_owner(entry)} cannot be imported: {type(error).__name__}: {error}",
            where=where,
            fix=fix,
        ) from error
    from .discovery import check_api

    check_api(entry, module)
    offered = _offered(module, hook, where)
    cls = offered.get(entry.name)
    if cls is None:
        known = listing(offered) if offered else "nothing"
        raise PluginError(
            f"the module registers {known}, not {entry.name!r}{did_you_mean(entry.name, offered)}",
            where=where,
            fix=f"call `register({entry.name!r}, ...)` in {hook}, below `@registry.hookimpl`",
        )
    if not (isinstance(cls, type) and issubclass(cls, kind)):
        raise PluginError(
            f"{entry.name!r} registers {cls!r}, not a subclass of registry.{kind.__name__}",
            where=where,
            fix=fix,
        )
    return cls()


def _offered(module: object, hook: str, where: str) -> dict[str, Any]:
    """All that a module registers through a hook, by name."""
    from ..contract.hook_points import (
        PROJECT,  # imports pydantic, which `stereogs --help` does without
    )

    offered: dict[str, Any] = {}

    def register(name: str, cls: Any) -> None:
        if name in offered:
            raise PluginError(f"{name!r} is registered twice", where=where, fix="register it once")
        offered[name] = cls

    implementation: Callable[..., None] | None = getattr(module, hook, None)
    if implementation is not None and hasattr(implementation, f"{PROJECT}_impl"):
        implementation(register)
    return offered


def _owner(entry: EntryPoint) -> str:
    return f"{entry.dist.name} {entry.dist.version}" if entry.dist else "the host"


def _source(module: str) -> str | None:
    """Source text of a module, found without importing it or its packages."""
    top, *rest = module.split(".")
    spec, name = find_spec(top), top
    for part in rest:
        if spec is None or spec.submodule_search_locations is None:
            return None
        name = f"{name}.{part}"
        spec = PathFinder.find_spec(name, list(spec.submodule_search_locations))
    loader: Any = spec.loader if spec else None
    return loader.get_source(name) if hasattr(loader, "get_source") else None
