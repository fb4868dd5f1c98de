"""Verbs and train options: listed by their entry points, imported on first use."""

from __future__ import annotations

import ast
from collections.abc import Sequence
from dataclasses import dataclass
from importlib.machinery import PathFinder
from importlib.metadata import EntryPoint, entry_points
from importlib.util import find_spec
from typing import Any

from ..contract.command import Command, TrainOption
from ..errors import PluginError
from ..messages.suggestions import did_you_mean, listing

COMMANDS, TRAIN_OPTIONS = "stereogs.commands", "stereogs.train_options"
"""Entry-point groups. An entry is named after the verb or option that its module registers."""
_BUILT_IN = {"train": "running:Train", "resume": "running:Resume"}
"""The host's own verbs, and their classes in `registry.commands`."""


@dataclass(frozen=True)
class Verb:
    """A verb of the command line, not imported yet; the entry point of a built-in verb has no group."""

    entry: EntryPoint

    @property
    def owner(self) -> str:
        """The package that offers it, and its version."""
        package = self.entry.dist
        return f"{package.name} {package.version}" if package else "the host"

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
        command: Command
        if self.entry.group:
            command = _registered(self.entry, "stereogs_register_commands", Command)
        else:  # built in
            command = self.entry.load()()
        return command


def verbs() -> dict[str, Verb]:
    """Return all verbs by name, the host's own first.

    Raises:
        PluginError: two packages offer a verb of the same name.
    """
    found = {
        name: Verb(EntryPoint(name, f"registry.commands.{value}", ""))
        for name, value in _BUILT_IN.items()
    }
    for entry in sorted(entry_points(group=COMMANDS), key=lambda entry: entry.name):
        if entry.name in found:
            owners = f"{found[entry.name].owner} and {Verb(entry).owner}"
            what = f"the verb {entry.name!r} is offered twice: by {owners}"
            raise PluginError(what, fix="uninstall one of them")
        found[entry.name] = Verb(entry)
    return found


def train_options(verb: str) -> Sequence[TrainOption]:
    """Return the options that plugins add to a verb, sorted by name.

    Raises:
        PluginError: one cannot be imported or does not register itself.
    """
    entries = sorted(entry_points(group=TRAIN_OPTIONS), key=lambda entry: entry.name)
    options = [_registered(e, "stereogs_register_train_options", TrainOption) for e in entries]
    return [option for option in options if verb in option.verbs]


def _registered(entry: EntryPoint, hook: str, base: type[Any]) -> Any:
    """Return an instance of the class that an entry's module registers under the entry's name."""
    # These import pydantic, which `stereogs --help` does without.
    from ..contract.hook_points import PROJECT
    from .discovery import check_api

    where = f"entry point {entry.group}: {entry.name} = {entry.value}"
    owner = Verb(entry).owner
    fix = f"update {owner}, or uninstall it"
    try:
        module = entry.load()
    except Exception as error:  # the module of a third party may raise anything
        what = f"{entry.name!r} of {owner} cannot be imported: {type(error).__name__}: {error}"
        raise PluginError(what, where=where, fix=fix) from error
    check_api(entry, module)
    offered: dict[str, Any] = {}

    def register(name: str, cls: Any) -> None:
        if name in offered:
            raise PluginError(f"{name!r} is registered twice", where=where, fix="register it once")
        offered[name] = cls

    implementation: Any = getattr(module, hook, None)
    if hasattr(implementation, f"{PROJECT}_impl"):
        implementation(register)
    cls = offered.get(entry.name)
    if cls is None:
        known = listing(offered) if offered else "nothing"
        raise PluginError(
            f"the module registers {known}, not {entry.name!r}{did_you_mean(entry.name, offered)}",
            where=where,
            fix=f"call `register({entry.name!r}, ...)` in {hook}, below `@registry.hookimpl`",
        )
    if not (isinstance(cls, type) and issubclass(cls, base)):
        what = f"{entry.name!r} registers {cls!r}, not a subclass of registry.{base.__name__}"
        raise PluginError(what, where=where, fix=fix)
    return cls()


def _source(module: str) -> str | None:
    """Return the source of a module without importing it or its packages."""
    top, *rest = module.split(".")
    spec, name = find_spec(top), top
    for part in rest:
        if spec is None or spec.submodule_search_locations is None:
            return None
        name = f"{name}.{part}"
        spec = PathFinder.find_spec(name, list(spec.submodule_search_locations))
    loader: Any = spec.loader if spec else None
    return loader.get_source(name) if hasattr(loader, "get_source") else None
