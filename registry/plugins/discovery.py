"""Discovery: find plugins through entry points, import only what is asked for, blame by name."""

from __future__ import annotations

import inspect
import os
import re
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass
from functools import cache
from importlib.metadata import Distribution, EntryPoint, entry_points, version
from typing import Any

import pluggy

from ..calls.process_state import left_as_found
from ..calls.watchdog import WATCHDOG, Hang
from ..contract import hooks
from ..contract.component import Component, Settings
from ..contract.components import SceneLoader
from ..contract.hook_points import API_VERSION, HOOK_POINTS, HookPoint
from ..contract.in_memory import IN_MEMORY, InMemoryScene
from ..errors import PluginError
from ..messages.suggestions import did_you_mean, listing

GROUP = "stereogs.plugins"
"""The entry-point group; the value of an entry is the plugin module's path."""
SELECTION = "STEREOGS_PLUGINS"
"""Environment variable: unset = every installed plugin, empty = none, else entry names by commas."""

_NAME = re.compile(r"[A-Za-z0-9][A-Za-z0-9_-]*")


@dataclass(frozen=True)
class Offer:
    """A component that a plugin registered.

    Args:
        point: the hook point it was registered at.
        name: what a pipeline writes after `use:`.
        component: its class.
        plugin: the entry point's name.
        distribution, version: the installed package that the entry point belongs to.
    """

    point: HookPoint
    name: str
    component: type[Component[Any]]
    plugin: str
    distribution: str
    version: str

    @property
    def settings_type(self) -> type[Settings]:
        """The model of its settings."""
        return self.component.Settings

    def __str__(self) -> str:
        return f"{self.point.title} {self.name!r} ({self.distribution} {self.version})"


class Plugins:
    """The installed plugins. Reading their names imports nothing; `find` imports what it must.

    An entry offers what it is named after: `psnr` and `anything.psnr` a component `psnr`. So the
    entries of that name are all that could offer it; they alone are imported, and two that do are
    never missed. A module that registers a name without an entry is refused. Each import is guarded:
    one that fails is remembered in `broken`.

    Args:
        entries: entry points to use instead of the installed ones that STEREOGS_PLUGINS selects.

    Raises:
        PluginError: STEREOGS_PLUGINS names a plugin that is not installed.
    """

    def __init__(self, entries: Iterable[EntryPoint] | None = None) -> None:
        self.entries: tuple[EntryPoint, ...] = (
            installed_entries() if entries is None else tuple(entries)
        )
        self.broken: dict[str, PluginError] = {}
        self._loaded: set[str] = set()
        self._offers: list[Offer] = []
        self._manager = pluggy.PluginManager(hooks.PROJECT)
        self._manager.add_hookspecs(hooks)

    def find(self, point: HookPoint, name: str) -> Offer:
        """The component of that name.

        Raises:
            PluginError: no plugin offers it, the plugin named like it cannot be loaded, or two
                plugins offer it.
        """
        if point.base is SceneLoader and name == IN_MEMORY:
            return _in_memory(point)
        alike = [entry for entry in self.entries if offered_name(entry) == name]
        self._load_all(alike)
        found = [o for o in self._offers if o.point is point and o.name == name]
        if len(found) > 1:
            raise _conflict(found)
        if found:
            return found[0]
        for entry in alike:
            if _key(entry) in self.broken:
                raise self.broken[_key(entry)]
        raise self._silent(point, alike[0]) if alike else self._unknown(point, name)

    def all(self) -> Sequence[Offer]:
        """Every component of every plugin that can be loaded; imports them all. See `broken`."""
        self._load_all(self.entries)
        order = {point.section: index for index, point in enumerate(HOOK_POINTS)}
        return sorted(self._offers, key=lambda offer: (order[offer.point.section], offer.name))

    def conflicts(self) -> list[PluginError]:
        """One error for each name that two plugins offer at one hook point; imports all."""
        groups: dict[tuple[str, str], list[Offer]] = {}
        for offer in self.all():
            groups.setdefault((offer.point.section, offer.name), []).append(offer)
        return [_conflict(group) for group in groups.values() if len(group) > 1]

    def _load_all(self, entries: Iterable[EntryPoint]) -> None:
        for entry in entries:
            key = _key(entry)
            if key in self._loaded or key in self.broken:
                continue
            try:
                self._load(entry)
            except PluginError as error:
                self.broken[key] = error

    def _load(self, entry: EntryPoint) -> None:
        key = _key(entry)
        who = f"the plugin {key}, while it is imported"
        try:
            with WATCHDOG.watching(who), left_as_found(who):
                module = entry.load()
                _check_api(entry, module)
                if not self._manager.is_registered(module):  # by another entry of the same module
                    self._manager.register(module, name=key)
                _check_hooks(module)
                offers = list(self._collect(entry, module))
            self._check_entries(entry, offers)
        except (Exception, SystemExit, Hang) as error:  # a stranger's module may raise anything
            if self._manager.has_plugin(key):
                self._manager.unregister(name=key)
            raise _unusable(entry, error) from error
        self._loaded.add(key)
        self._offers.extend(offer for offer in offers if offer.name == offered_name(entry))

    def _check_entries(self, entry: EntryPoint, offers: Sequence[Offer]) -> None:
        """Refuse an entry point and a registered name that do not match each other."""
        beside = entry.dist.entry_points if entry.dist else self.entries
        mine = [e for e in beside if e.group == GROUP and e.value == entry.value]
        named = {offered_name(e) for e in mine}
        for offer in offers:
            if offer.name not in named:
                raise PluginError(
                    f"it registers the {offer.point.title} {offer.name!r}, but no entry point of "
                    f"{offer.distribution} that leads to {entry.value} is named so",
                    fix=f'add `{offer.name} = "{entry.value}"` to its entry points, and install it '
                    "again",
                )
        if offers and offered_name(entry) not in {offer.name for offer in offers}:
            names = listing(dict.fromkeys(offer.name for offer in offers))
            raise PluginError(
                f"its entry point is named {entry.name!r}, but {entry.value} registers {names}",
                fix=f"rename the entry point or register {offered_name(entry)!r}; then install it again",
            )

    def _collect(self, entry: EntryPoint, module: object) -> Iterator[Offer]:
        distribution, version = _distribution(entry)
        for point in HOOK_POINTS:
            caller: pluggy.HookCaller = getattr(self._manager.hook, point.hook)
            taken: list[tuple[str, type[Component[Any]]]] = []
            for implementation in caller.get_hookimpls():
                if implementation.plugin is module:
                    implementation.function(lambda name, cls, to=taken: to.append((name, cls)))
            for position, (name, component) in enumerate(taken):
                check_offer(point, name, component)
                if name in (earlier for earlier, _ in taken[:position]):
                    raise PluginError(f"the {point.title} {name!r} is registered twice")
                yield Offer(point, name, component, entry.name, distribution, version)

    def _unknown(self, point: HookPoint, name: str) -> PluginError:
        """No entry has that name. What others are called is known without importing any."""
        known = [offered_name(entry) for entry in self.entries]
        return PluginError(
            f"no plugin offers the {point.title} {name!r}{did_you_mean(name, known)}",
            fix="`stereogs plugins` lists what there is, and what cannot be loaded"
            if self.entries
            else f"install a plugin package, or unset {SELECTION}",
        )

    def _silent(self, point: HookPoint, entry: EntryPoint) -> PluginError:
        """An entry of that name, whose module offers something else or nothing."""
        name = offered_name(entry)
        what = f"no plugin offers the {point.title} {name!r}"
        elsewhere = [offer.point for offer in self._offers if offer.name == name]
        if elsewhere:
            section = elsewhere[0].section
            return PluginError(
                f"{what}; there is a {elsewhere[0].title} of that name, for {section!r}",
                fix=f"move it to {section!r}; `stereogs plugins` lists what there is",
            )
        return PluginError(
            f"{what}: the plugin {_key(entry)} is there, and registers nothing of that name",
            where=f"entry point {GROUP}: {entry.name} = {entry.value}",
            fix=f"does {point.hook} have its `@registry.hookimpl`, and register {name!r}?",
        )


def offered_name(entry: EntryPoint) -> str:
    """The name of the component that an entry offers: its own, without what stands before a dot."""
    return entry.name.rpartition(".")[2]


def installed_entries() -> tuple[EntryPoint, ...]:
    """The entry points of all installed plugins that STEREOGS_PLUGINS admits, by name."""
    found = sorted(entry_points(group=GROUP), key=_key)
    selection = os.environ.get(SELECTION)
    if selection is None:
        return tuple(found)
    wanted = [name.strip() for name in selection.split(",") if name.strip()]
    names = [entry.name for entry in found]
    for name in wanted:
        if name not in names:
            raise PluginError(
                f"no installed plugin is named {name!r}{did_you_mean(name, names)}",
                where=f"the environment variable {SELECTION}",
                fix=f"use names from: {listing(names)}",
            )
    return tuple(entry for entry in found if entry.name in wanted)


def check_offer(point: HookPoint, name: object, component: object) -> None:
    """Refuse a name or class that the host could not use.

    Raises:
        PluginError: the name is not a plain word, the class does not derive from the hook point's
            base or leaves a method out, or its settings claim a name that belongs to the host.
    """
    if not isinstance(name, str) or not _NAME.fullmatch(name):
        raise PluginError(
            f"the name {name!r} of a {point.title} is not a word of letters, digits, '-' and '_'"
        )
    if not (isinstance(component, type) and issubclass(component, point.base)):
        raise PluginError(
            f"the {point.title} {name!r} is {component!r}, not a subclass of "
            f"registry.{point.base.__name__}"
        )
    if inspect.isabstract(component):
        missing = ", ".join(sorted(getattr(component, "__abstractmethods__", ())))
        raise PluginError(f"the {point.title} {name!r} does not define {missing}")
    if not (isinstance(component.Settings, type) and issubclass(component.Settings, Settings)):
        raise PluginError(
            f"the Settings of the {point.title} {name!r} do not derive from registry.Settings"
        )
    claimed = [field for field in component.Settings.model_fields if field in point.host_settings]
    if claimed:
        raise PluginError(
            f"the {point.title} {name!r} has a setting {claimed[0]!r}, which belongs to the host",
            fix="give the setting another name",
        )


def _check_api(entry: EntryPoint, module: object) -> None:
    wanted = getattr(module, "STEREOGS_API", API_VERSION)
    if wanted != API_VERSION:
        raise PluginError(
            f"it needs stereogs API {wanted}, this is API {API_VERSION}",
            fix=f"pip install -U {_distribution(entry)[0]} stereogs-plugins",
        )


def _check_hooks(module: object) -> None:
    """Refuse a hook that nobody calls, because its name is misspelt."""
    known = [point.hook for point in HOOK_POINTS]
    for name, member in vars(module).items():
        options = getattr(member, f"{hooks.PROJECT}_impl", None)
        hook = (options.get("specname") or name) if isinstance(options, dict) else known[0]
        if hook not in known:
            raise PluginError(
                f"there is no hook {hook!r}{did_you_mean(hook, known)}",
                fix=f"hooks: {listing(known)}",
            )


def _distribution(entry: EntryPoint) -> tuple[str, str]:
    return _name_and_version(entry.dist) if entry.dist else ("unknown package", "?")


@cache
def _name_and_version(distribution: Distribution) -> tuple[str, str]:
    """Read once: each of the two parses the package's metadata anew."""
    return distribution.name, distribution.version


def _in_memory(point: HookPoint) -> Offer:
    """The host's own stand-in for scenes that are given as objects; no listing shows it."""
    package = "stereogs-plugins"
    return Offer(point, IN_MEMORY, InMemoryScene, "registry", package, version(package))


def _key(entry: EntryPoint) -> str:
    """Unique among all plugins: two packages may use one entry name."""
    return f"{entry.name} ({' '.join(_distribution(entry))})"


def _unusable(entry: EntryPoint, error: BaseException) -> PluginError:
    if isinstance(error, Hang):
        error = error.explained()
    reason = error.what if isinstance(error, PluginError) else f"{type(error).__name__}: {error}"
    fix = error.fix if isinstance(error, PluginError) else ""
    distribution = _distribution(entry)[0]
    return PluginError(
        f"the plugin {_key(entry)} cannot be used: {reason}",
        where=f"entry point {GROUP}: {entry.name} = {entry.value}",
        fix=fix or f"mend or update {distribution}, or remove what uses it from the pipeline",
    )


def _conflict(offers: Sequence[Offer]) -> PluginError:
    first = offers[0]
    owners = " and ".join(f"{o.plugin} ({o.distribution} {o.version})" for o in offers)
    fix = "uninstall one of them"
    if len({offer.plugin for offer in offers}) == len(offers):
        fix += f", or name the plugins to load in {SELECTION}"
    return PluginError(
        f"the {first.point.title} {first.name!r} is offered twice: by {owners}", fix=fix
    )
