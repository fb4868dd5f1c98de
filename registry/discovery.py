"""Find plugins through entry points, import only those that are used, and report those that fail."""

from __future__ import annotations

import inspect
import logging
import os
import re
from collections import Counter
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass, replace
from functools import cache
from importlib.metadata import (
    Distribution,
    EntryPoint,
    PackageNotFoundError,
    entry_points,
    version,
)
from itertools import groupby
from typing import Any

from .calls.process_state import left_as_found
from .calls.watchdog import WATCHDOG, Hang
from .contract.component import Component, Settings
from .contract.components import IN_MEMORY, InMemoryScene, SceneLoader
from .contract.hook_points import API_VERSION, HOOK_POINTS, OTHER_HOOKS, PROJECT, HookPoint
from .contract.host_defaults import HostDefaults
from .errors import PluginError
from .messages.suggestions import did_you_mean, listing

GROUP = "stereogs.plugins"
"""The entry-point group; the value of an entry is the plugin module's path."""
SELECTION = "STEREOGS_PLUGINS"
"""Environment variable: unset = every installed plugin, empty = none, else entry names by commas."""

SCENE, PRIORS, CONFIDENCE = (
    point for point in HOOK_POINTS if point.section in ("scene", "priors", "confidence")
)
"""The hook points of scene loaders and of confidence estimators."""
OWN_PACKAGE = "stereogs-plugins"
_log = logging.getLogger(__name__)
_NAME = re.compile(r"[A-Za-z0-9][A-Za-z0-9_-]*")


@dataclass(frozen=True)
class Offer:
    """A component that a plugin registered.

    Args:
        point: the hook point at which it is registered.
        name: the name that a pipeline writes after `use:`.
        component: its class.
        plugin: the entry point's name.
        distribution, version: the installed package that the entry point belongs to.
        ambiguous: whether another package offers the name too.
    """

    point: HookPoint
    name: str
    component: type[Component[Any]]
    plugin: str
    distribution: str
    version: str
    ambiguous: bool = False

    @property
    def use(self) -> str:
        """What a pipeline writes after `use:`, NAME or PACKAGE/NAME."""
        return f"{self.distribution}/{self.name}" if self.ambiguous else self.name

    @property
    def settings_type(self) -> type[Settings]:
        """Model of its settings."""
        return self.component.Settings

    def __str__(self) -> str:
        return f"{self.point.title} {self.name!r} ({self.distribution} {self.version})"


class Plugins:
    """The installed plugins, imported only when they are needed.

    An entry point has the name of its component: `psnr` and `anything.psnr` offer `psnr`. `find` imports
    the entry points of that name only, and notices if two offer it. A module is refused if it registers a
    name without an entry point or does not register the name of its entry point. `broken` holds the
    errors of failed imports.

    Args:
        entries: instead of the installed entry points that STEREOGS_PLUGINS selects.

    Raises:
        PluginError: STEREOGS_PLUGINS names a plugin that is not installed.
    """

    def __init__(self, entries: Iterable[EntryPoint] | None = None) -> None:
        self.entries = installed_entries() if entries is None else tuple(entries)
        self.broken: dict[str, PluginError] = {}
        self._named: dict[str, list[EntryPoint]] = {}
        for entry in self.entries:
            self._named.setdefault(offered_name(entry), []).append(entry)
        self._loaded: set[str] = set()
        self._offers: list[Offer] = []

    def find(self, point: HookPoint, name: str, preferred: str | None = None) -> Offer:
        """Return the component of that name.

        Args:
            name: as after `use:`, NAME or PACKAGE/NAME.
            preferred: the package whose component a bare name means if several offer it.

        Raises:
            PluginError: no plugin offers it, its plugin cannot be loaded, or two plugins offer it.
        """
        package, _, name = name.rpartition("/")
        if point.base is SceneLoader and name == IN_MEMORY:  # of the host, and not listed
            return Offer(point, name, InMemoryScene, "registry", OWN_PACKAGE, version(OWN_PACKAGE))
        alike = self._named.get(name, [])
        if package:
            owners = [_distribution(entry.dist)[0] for entry in alike]
            alike = [e for e, owner in zip(alike, owners, strict=True) if _same(owner, package)]
            if not alike:
                what = f"the package {package!r} offers no {point.title} {name!r}"
                fix = "`stereogs plugins --json` lists all components with their packages"
                offered = f"; installed: {listing(f'{o}/{name}' for o in owners)}" if owners else ""
                raise PluginError(f"{what}{offered}", fix=fix)
        self._load(alike)
        found = [o for o in self._offers if o.point is point and o.name == name]
        chosen = [offer for offer in found if _same(offer.distribution, package or preferred)]
        if len(found) > 1 and len(chosen) != 1:
            raise _conflict(found)
        if found:
            offer = chosen[0] if chosen else found[0]
            return replace(offer, ambiguous=len(found) > 1 or bool(package))
        for entry in alike:
            if _key(entry) in self.broken:
                raise self.broken[_key(entry)]
        raise self._not_offered(point, name, alike)

    def all(self) -> Sequence[Offer]:
        """Import all plugins and return every component of those that load. See `broken`."""
        self._load(self.entries)
        count = Counter((offer.point.section, offer.name) for offer in self._offers)
        offers = (replace(o, ambiguous=count[o.point.section, o.name] > 1) for o in self._offers)
        return sorted(offers, key=lambda offer: (HOOK_POINTS.index(offer.point), offer.name))

    def conflicts(self) -> list[PluginError]:
        """Import all plugins and return an error for each name that two offer at one hook point."""
        groups = groupby(self.all(), key=lambda offer: (offer.point.section, offer.name))
        alike = [list(group) for _, group in groups]
        return [_conflict(group) for group in alike if len(group) > 1]

    def _load(self, entries: Iterable[EntryPoint]) -> None:
        for entry in entries:
            key = _key(entry)
            if key in self._loaded or key in self.broken:
                continue
            who = f"the plugin {key}, while it is imported"
            try:
                _warn_of_requirements(entry.dist)
                with WATCHDOG.watching(who), left_as_found(who):
                    module = entry.load()
                    check_api(entry, module)
                    offers = list(_collect(entry, module))
                self._check_entries(entry, offers)
            except (Exception, SystemExit, Hang) as error:  # the module may raise anything
                self.broken[key] = _unusable(entry, error)
                continue
            self._loaded.add(key)
            self._offers.extend(offer for offer in offers if offer.name == offered_name(entry))

    def _check_entries(self, entry: EntryPoint, offers: Sequence[Offer]) -> None:
        """Refuse an entry point and a registered name that do not match each other."""
        beside = entry.dist.entry_points if entry.dist else self.entries
        named = {offered_name(e) for e in beside if e.group == GROUP and e.value == entry.value}
        for offer in offers:
            if offer.name not in named:
                raise PluginError(
                    f"it registers the {offer.point.title} {offer.name!r}, but no entry point of "
                    f"{offer.distribution} with the value {entry.value} has that name",
                    fix=f'add `{offer.name} = "{entry.value}"` to its entry points, and reinstall it',
                )
        names = dict.fromkeys(offer.name for offer in offers)
        if names and offered_name(entry) not in names:
            raise PluginError(
                f"its entry point is named {entry.name!r}, but {entry.value} registers {listing(names)}",
                fix=f"rename the entry point or register {offered_name(entry)!r}; then reinstall it",
            )

    def _not_offered(self, point: HookPoint, name: str, alike: Sequence[EntryPoint]) -> PluginError:
        """Return the error for a name that no plugin offers; `alike` are its loaded entry points."""
        what = f"no plugin offers the {point.title} {name!r}"
        if not alike:
            known = list(self._named)
            return PluginError(
                f"{what}{did_you_mean(name, known)}",
                fix="`stereogs plugins` lists all components, and plugins that cannot be loaded"
                if self.entries
                else f"install a plugin package, or unset {SELECTION}",
            )
        other = next((offer.point for offer in self._offers if offer.name == name), None)
        if other is not None:
            return PluginError(
                f"{what}; there is a {other.title} of that name, for {other.section!r}",
                fix=f"move it to {other.section!r}; `stereogs plugins` lists all components",
            )
        return PluginError(
            f"{what}: the plugin {_key(alike[0])} is installed but does not register that name",
            where=_where(alike[0]),
            fix=f"does {point.hook} have its decorator `@hookimpl`, and register {name!r}?",
        )


def _collect(entry: EntryPoint, module: object) -> Iterator[Offer]:
    """Call the module's hooks and yield what they register."""
    distribution, version = _distribution(entry.dist)
    points = {point.hook: point for point in HOOK_POINTS}
    for member_name, member in list(vars(module).items()):
        options = getattr(member, f"{PROJECT}_impl", None)
        if not isinstance(options, dict):
            continue
        hook = options.get("specname") or member_name
        if hook in OTHER_HOOKS:
            continue
        if hook not in points:
            what = f"there is no hook {hook!r}{did_you_mean(hook, points)}"
            raise PluginError(what, fix=f"hooks: {listing(points)}")
        taken: dict[str, Offer] = {}

        def register(name: str, component: Any, point=points[hook], taken=taken) -> None:  # type: ignore[no-untyped-def]
            check_offer(point, name, component)
            if name in taken:
                raise PluginError(f"the {point.title} {name!r} is registered twice")
            taken[name] = Offer(point, name, component, entry.name, distribution, version)

        member(register)
        yield from taken.values()


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
        PluginError: the name is not a word, the class does not derive from the hook point's base or lacks
            a method, or a setting has a name that belongs to the host.
    """
    if not isinstance(name, str) or not _NAME.fullmatch(name):
        raise PluginError(
            f"the name {name!r} of a {point.title} is not a word of letters, digits, '-' and '_'"
        )
    who, base = f"the {point.title} {name!r}", point.base
    if not (isinstance(component, type) and issubclass(component, base)):
        raise PluginError(f"{who} is {component!r}, not a subclass of stereogs.api.{base.__name__}")
    if inspect.isabstract(component):
        missing = ", ".join(sorted(getattr(component, "__abstractmethods__", ())))
        raise PluginError(f"{who} does not define {missing}")
    if not (isinstance(component.Settings, type) and issubclass(component.Settings, Settings)):
        raise PluginError(f"the Settings of {who} do not derive from stereogs.api.Settings")
    if not isinstance(component.host_defaults, HostDefaults):
        what = f"the host_defaults of {who} are not a HostDefaults"
        raise PluginError(what, fix="write for example `host_defaults = HostDefaults(every=100)`")
    for setting in component.Settings.model_fields:
        if setting in point.host_settings:
            what = f"{who} has a setting {setting!r}, which belongs to the host"
            raise PluginError(what, fix="give the setting another name")


def check_api(entry: EntryPoint, module: object) -> None:
    """Raise a PluginError if the module was written for another version of the plugin API."""
    wanted = getattr(module, "STEREOGS_API", API_VERSION)
    if wanted != API_VERSION:
        raise PluginError(
            f"it needs stereogs API {wanted}, this is API {API_VERSION}",
            fix=f"pip install -U {_distribution(entry.dist)[0]} stereogs-plugins",
        )


@cache
def _distribution(package: Distribution | None) -> tuple[str, str]:
    """Name and version; cached, because each attribute parses the package's metadata again."""
    return (package.name, package.version) if package else ("unknown package", "?")


def _key(entry: EntryPoint) -> str:
    """Unique among all plugins: two packages may use one entry name."""
    return f"{entry.name} ({' '.join(_distribution(entry.dist))})"


@cache
def _warn_of_requirements(package: Distribution | None) -> None:
    """Warn of requirements of another package than this project's that the installed ones do not meet."""
    if package is None or package.name == OWN_PACKAGE:
        return
    from packaging.requirements import Requirement

    unmet = []
    for required in map(Requirement, package.requires or ()):
        if required.marker and not required.marker.evaluate({"extra": ""}):
            continue
        try:
            found = version(required.name)
        except PackageNotFoundError:
            unmet.append(f"{required}, which is not installed")
            continue
        if not required.specifier.contains(found, prereleases=True):
            unmet.append(f"{required}, but {required.name} {found} is installed")
    if unmet:
        who = f"the package {package.name} {package.version}"
        _log.warning("%s requires %s; `pip check` lists all such packages", who, "; ".join(unmet))


def _same(package: str, other: str | None) -> bool:
    """Whether two names are of one package: case, dots, dashes and underscores do not count."""
    return other is not None and _normal(package) == _normal(other)


def _normal(package: str) -> str:
    return re.sub(r"[-_.]+", "-", package).lower()


def _where(entry: EntryPoint) -> str:
    return f"entry point {GROUP}: {entry.name} = {entry.value}"


def _unusable(entry: EntryPoint, error: BaseException) -> PluginError:
    explained = error.explained() if isinstance(error, Hang) else error
    reason, fix = f"{type(error).__name__}: {error}", ""
    if isinstance(explained, PluginError):
        reason, fix = explained.what, explained.fix
    package = _distribution(entry.dist)[0]
    fault = PluginError(
        f"the plugin {_key(entry)} cannot be used: {reason}",
        where=_where(entry),
        fix=fix or f"fix or update {package}, or remove its components from the pipeline",
    )
    fault.__cause__ = error
    return fault


def _conflict(offers: Sequence[Offer]) -> PluginError:
    first = offers[0]
    owners = " and ".join(f"{o.plugin} ({o.distribution} {o.version})" for o in offers)
    packages = list(dict.fromkeys(offer.distribution for offer in offers))
    fix = "uninstall one of them"
    if len(packages) == len(offers):
        fix = f"write `use: {first.distribution}/{first.name}`, or another package, or {fix}"
    if len({offer.plugin for offer in offers}) == len(offers):
        fix += f", or name the plugins to load in {SELECTION}"
    what = f"the {first.point.title} {first.name!r} is offered twice: by {owners}"
    return PluginError(what, fix=fix)
