"""Verbs and train options: the application's own, and those of entry points; imported on first use."""

from __future__ import annotations

import ast
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from importlib.machinery import PathFinder
from importlib.metadata import EntryPoint, entry_points
from importlib.util import find_spec
from typing import Any

from registry.errors import PluginError
from registry.messages.suggestions import did_you_mean, listing

from .command import Command, TrainOption

COMMANDS, TRAIN_OPTIONS = "stereogs.commands", "stereogs.train_options"
"""Entry-point groups. An entry is named after the verb or option that its module registers."""
_VERBS = {
    "train": "verbs.train:Train",
    "resume": "verbs.train:Resume",
    "ablate": "experiments.ablate:Ablate",
    "bench": "experiments.bench:Bench",
    "benchmark": "experiments.benchmark:Benchmark",
    "check": "verbs.check.verb:Check",
    "compare": "experiments.compare:Compare",
    "completion": "verbs.completion:Completion",
    "data": "verbs.data.verb:Data",
    "demo": "verbs.demo:Demo",
    "doctor": "verbs.doctor:Doctor",
    "eval": "verbs.eval:Eval",
    "explain": "verbs.components.explain:Explain",
    "export": "verbs.export:Export",
    "init": "verbs.init:Init",
    "models": "verbs.models.verb:Models",
    "new-plugin": "verbs.new_plugin.verb:NewPlugin",
    "next": "verbs.next_views.verb:Next",
    "plugins": "verbs.components.plugins:ListPlugins",
    "priors": "verbs.priors.verb:Priors",
    "render": "verbs.render:Render",
    "replay": "verbs.replay:Replay",
    "report": "verbs.report:Report",
    "schema": "verbs.schema:PrintSchema",
    "view": "verbs.view.verb:View",
}
"""The application's own verbs, and their classes in `stereogs`."""
_OPTIONS = {
    "other_processes": "verbs.other_processes:OtherProcesses",
    "photos": "verbs.check.option:PhotoOptions",
    "view": "verbs.view.option:LiveView",
}
"""The application's own options of `train` and `resume`."""


@dataclass(frozen=True)
class Verb:
    """A verb of the command line, not imported yet; the entry points of our own verbs have an empty group."""

    entry: EntryPoint

    @property
    def owner(self) -> str:
        """The package that offers it, and its version."""
        package = self.entry.dist
        return f"{package.name} {package.version}" if package else "stereogs"

    @property
    def summary(self) -> str:
        """First line of the docstring, read without importing the module; "" if there is none.

        Of the class of an own verb if it has one, else of the module.
        """
        module = ast.parse(_source(self.entry.module) or "")
        classes = {node.name: node for node in module.body if isinstance(node, ast.ClassDef)}
        text = self.entry.attr and ast.get_docstring(classes[self.entry.attr])
        line = (text or ast.get_docstring(module) or "").partition("\n")[0].rstrip(".")
        return line[:1].lower() + line[1:]

    def load(self) -> Command:
        """Import the module and build the command.

        Raises:
            PluginError: the module cannot be imported or does not register the verb.
        """
        command: Command = _loaded(self.entry, "stereogs_register_commands", Command)
        return command


def verbs() -> dict[str, Verb]:
    """Return all verbs by name, the application's own first.

    Raises:
        PluginError: two packages offer a verb of the same name.
    """
    found: dict[str, Verb] = {}
    for entry in _entries(_VERBS, COMMANDS):
        if entry.name in found:
            owners = f"{found[entry.name].owner} and {Verb(entry).owner}"
            what = f"the verb {entry.name!r} is offered twice: by {owners}"
            raise PluginError(what, fix="uninstall one of them")
        found[entry.name] = Verb(entry)
    return found


def train_options(verb: str) -> Sequence[TrainOption]:
    """Return the options that are added to a verb: the application's own, then those of plugins by name.

    Raises:
        PluginError: one cannot be imported or does not register itself.
    """
    entries = _entries(_OPTIONS, TRAIN_OPTIONS)
    options = [_loaded(e, "stereogs_register_train_options", TrainOption) for e in entries]
    return [option for option in options if verb in option.verbs]


def _entries(own: dict[str, str], group: str) -> Iterator[EntryPoint]:
    """Yield the application's own entries, then the installed ones by name."""
    for name, place in own.items():
        yield EntryPoint(name, f"stereogs.{place}", "")
    yield from sorted(entry_points(group=group), key=lambda entry: entry.name)


def _loaded(entry: EntryPoint, hook: str, base: type[Any]) -> Any:
    """Return an instance of the class that an entry names or that its module registers."""
    return _registered(entry, hook, base) if entry.group else entry.load()()


def _registered(entry: EntryPoint, hook: str, base: type[Any]) -> Any:
    """Return an instance of the class that an entry's module registers under the entry's name."""
    # These import pydantic, which `stereogs --help` does without.
    from registry.contract.hook_points import PROJECT
    from registry.discovery import check_api

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
            fix=f"call `register({entry.name!r}, ...)` in {hook}, below `@hookimpl`",
        )
    if not (isinstance(cls, type) and issubclass(cls, base)):
        what = f"{entry.name!r} registers {cls!r}, not a subclass of stereogs.api.{base.__name__}"
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
