"""Find plugins through entry points, import only those that are used, and name those that fail."""

from __future__ import annotations

import inspect
import os
import re
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass
from functools import cache
from importlib.metadata import Distribution, EntryPoint, entry_points, version
from typing import Any

from ..calls.process_state import left_as_found
from ..calls.watchdog import WATCHDOG, Hang
from ..contract.component import Component, Settings
from ..contract.components import IN_MEMORY, InMemoryScene, SceneLoader
from ..contract.hook_points import API_VERSION, HOOK_POINTS, OTHER_HOOKS, PROJECT, HookPoint
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
    """The installed plugins. Reading their names imports nothing; `find` imports what it needs.

    An entry point has the name of its component: `psnr` and `anything.psnr` offer `psnr`. `find` imports
    the entry points of that name only, so it notices if two offer it. A module that registers a name
    without an entry point, or lacks the name of its entry point, is refused. `broken` holds the errors
    of failed imports.

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

    def find(self, point: HookPoint, name: str) -> Offer:
        """Return the component of that name.

        Raises:
            PluginError: no plugin offers it, its plugin cannot be loaded, or two plugins offer it.
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
        """Import all plugins and return every component of those that load. See `broken`."""
        self._load_all(self.entries)
        order = {point.section: index for index, point in enumerate(HOOK_POINTS)}
        return sorted(self._offers, key=lambda offer: (order[offer.point.section], offer.name))

    def conflicts(self) -> list[PluginError]:
        """Import all plugins and return an error for each name that two offer at one hook point."""
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
                check_api(entry, module)
                offers = list(self._collect(entry, module))
            self._check_entries(entry, offers)
        except (Exception, SystemExit, Hang) as error:  # the module may raise anything
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

    @staticmethod
    def _collect(entry: EntryPoint, module: object) -> Iterator[Offer]:
        """Call the module's hooks and yield what they register."""
        distribution, version = _distribution(entry)
        points = {point.hook: point for point in HOOK_POINTS}
        for member_name, member in list(vars(module).items()):
            options = getattr(member, f"{PROJECT}_impl", None)
            if not isinstance(options, dict):
                continue
            hook = options.get("specname") or member_name
            if hook in OTHER_HOOKS:
                continue
            if hook not in points:
                raise PluginError(
                    f"there is no hook {hook!r}{did_you_mean(hook, points)}",
                    fix=f"hooks: {listing(points)}",
                )
            taken: dict[str, Offer] = {}

            def register(name: str, component: Any, point=points[hook], taken=taken) -> None:  # type: ignore[no-untyped-def]
                check_offer(point, name, component)
                if name in taken:
                    raise PluginError(f"the {point.title} {name!r} is registered twice")
                taken[name] = Offer(point, name, component, entry.name, distribution, version)

            member(register)
            yield from taken.values()

    def _unknown(self, point: HookPoint, name: str) -> PluginError:
        """Error for a name that no entry point has; imports nothing."""
        known = [offered_name(entry) for entry in self.entries]
        return PluginError(
            f"no plugin offers the {point.title} {name!r}{did_you_mean(name, known)}",
            fix="`stereogs plugins` lists all components, and plugins that cannot be loaded"
            if self.entries
            else f"install a plugin package, or unset {SELECTION}",
        )

    def _silent(self, point: HookPoint, entry: EntryPoint) -> PluginError:
        """Error for an entry point whose module registers nothing, or another kind of component."""
        name = offered_name(entry)
        what = f"no plugin offers the {point.title} {name!r}"
        elsewhere = [offer.point for offer in self._offers if offer.name == name]
        if elsewhere:
            section = elsewhere[0].section
            return PluginError(
                f"{what}; there is a {elsewhere[0].title} of that name, for {section!r}",
                fix=f"move it to {section!r}; `stereogs plugins` lists all components",
            )
        return PluginError(
            f"{what}: the plugin {_key(entry)} is installed but does not register that name",
            where=f"entry point {GROUP}: {entry.name} = {entry.value}",
            fix=f"does {point.hook} have its `@registry.hookimpl`, and register {name!r}?",
        )


def offered_name(entry: EntryPoint) -> str:
    """Return the name of the component that an entry point offers: its part after the last dot."""
    return entry.name.rpartition(".")[2]


def installed_entries() -> tuple[EntryPoint, ...]:
    """Return the entry points of the installed plugins that STEREOGS_PLUGINS selects, by name."""
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
    """Check a name and class that a plugin registers.

    Raises:
        PluginError: the name is not a plain word, the class does not derive from the hook point's
            base or lacks a method, or its settings use a name that belongs to the host.
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


def check_api(entry: EntryPoint, module: object) -> None:
    """Raise a PluginError if the module was written for another version of the plugin API."""
    wanted = getattr(module, "STEREOGS_API", API_VERSION)
    if wanted not in (2, API_VERSION):  # names that documented plugins of 2 import are kept
        raise PluginError(
            f"it needs stereogs API {wanted}, this is API {API_VERSION}",
            fix=f"pip install -U {_distribution(entry)[0]} stereogs-plugins",
        )


def _distribution(entry: EntryPoint) -> tuple[str, str]:
    return _name_and_version(entry.dist) if entry.dist else ("unknown package", "?")


@cache
def _name_and_version(distribution: Distribution) -> tuple[str, str]:
    """Cached, because each attribute parses the package's metadata again."""
    return distribution.name, distribution.version


def _in_memory(point: HookPoint) -> Offer:
    """Offer of the host's loader for scenes made in Python; not listed."""
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
        fix=fix or f"fix or update {distribution}, or remove its components from the pipeline",
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
