"""A pipeline: its components, their settings and their order; read from YAML, checked, and written."""

from __future__ import annotations

from collections.abc import Callable, Collection, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from fractions import Fraction
from functools import cached_property
from pathlib import Path
from typing import Any

from core_rasterizer.errors import ExplainedError

from ..contract.component import Settings
from ..contract.components import SceneLoader
from ..contract.hook_points import PIPELINE_POINTS, HookPoint
from ..contract.prior import Prior, chosen_prior
from ..discovery import PRIORS, SCENE, Offer, Plugins
from ..errors import PipelineError, PluginError
from ..messages.suggestions import did_you_mean, listing
from ..messages.visible_text import is_plain_name
from .edits import TOP_LEVEL, apply_overrides, check_section, disable, expand
from .protocols import AppliedProtocol, apply_protocol
from .ready import find_pipeline, packager
from .schedule import HostSettings, Schedule, in_iterations, with_defaults
from .settings_check import escape_variables, paths_of, plain, recorded, validate_settings
from .training_settings import TrainingSettings, iterations_of_a_run, read_training
from .yaml_source import Node, Place, parse, read, to_yaml

Find = Callable[[HookPoint, str, str | None], Offer]
"""As `Plugins.find`."""


@dataclass(frozen=True)
class Item:
    """One component of a pipeline.

    Args:
        name: unique in its section.
        settings: the component's own settings.
        host: the settings that the host reads.
        place: where the pipeline names it.
        fallback: for a prior from `fallbacks`, which one and why, as a sentence; else empty.
    """

    name: str
    settings: Settings
    host: HostSettings
    offer: Offer = field(compare=False)
    place: Place = field(compare=False)
    fallback: str = field(default="", compare=False)

    @property
    def point(self) -> HookPoint:
        """The hook point of its section."""
        return self.offer.point

    @property
    def schedule(self) -> Schedule:
        """The iterations in which it is called."""
        return self.host

    @property
    def qualified_name(self) -> str:
        """Unique in the pipeline, for example "regularizers.stereo_depth"."""
        return f"{self.point.section}.{self.name}"

    def __str__(self) -> str:
        return self._text

    @cached_property
    def _text(self) -> str:
        return f"{self.offer} at {self.place}"

    @property
    def kind(self) -> str:
        """Title and name for messages, for example "metric 'psnr'"."""
        return f"{self.point.title} {self.offer.name!r}"

    @property
    def advice(self) -> str:
        """How a user can work around it if it fails."""
        report = f"report it to the authors of {self.offer.distribution}"
        if self.point.required or issubclass(self.point.base, Prior):
            return f"{report}, or put another {self.point.title} in its place"
        return f"{report}, or switch it off with `--disable {self.offer.name}`"


@dataclass(frozen=True)
class Pipeline:
    """The components and settings of a run, complete and checked.

    Args:
        items: the enabled components of each section, in the order of the file.
        protocol: fixes the split, the images and the metrics; None leaves them to the pipeline.
        iterations_per_view: for `for_views`; None if the length does not depend on the scene.
        missing: components that were left out because they cannot be loaded, see `build_pipeline`.
    """

    name: str
    items: dict[str, tuple[Item, ...]]
    training: TrainingSettings
    protocol: AppliedProtocol | None = None
    iterations_per_view: int | None = None
    missing: Mapping[str, ExplainedError] = field(default_factory=dict, compare=False)

    def __iter__(self) -> Iterator[Item]:
        """All components, section by section."""
        return (item for section in self.items.values() for item in section)

    def one(self, section: str) -> Item:
        """The component of a section that holds exactly one: "scene" or "initializer"."""
        (item,) = self.items[section]
        return item

    def scaled(self, iterations: int) -> Pipeline:
        """Return the pipeline with another number of iterations, and schedules scaled in proportion.

        `--set training.iterations=N` scales only shares. This also scales iterations that are written as
        numbers, rounded down: a start in iteration 100 of 400 becomes 50 of 200. The first iteration and
        `every: 1` stay as they are.

        Args:
            iterations: >= 1.
        """
        factor = Fraction(iterations, self.training.iterations)
        if factor == 1:
            return replace(self, iterations_per_view=None)
        items = {
            section: tuple(
                replace(item, host=item.host.scaled(factor)) if item.point.scheduled else item
                for item in items
            )
            for section, items in self.items.items()
        }
        training = self.training.scaled(iterations)
        return replace(self, items=items, training=training, iterations_per_view=None)

    def for_views(self, views: int) -> Pipeline:
        """Return the pipeline with length, rates and limit of Gaussians for a number of training views."""
        if self.iterations_per_view is None:
            return self
        scaled = self.scaled(self.iterations_per_view * views)
        return replace(scaled, training=scaled.training.for_views(views))

    def wrote(self, text: str) -> bool:
        """Return whether a run of this pipeline, for any number of training views, writes this file."""
        if self.iterations_per_view is None:
            return text == self.to_yaml()
        views = iterations_of_a_run(text) // self.iterations_per_view
        return views > 0 and text == self.for_views(views).to_yaml()

    def plain(self, escaped: Callable[[Any], Any] = lambda value: value) -> dict[str, Any]:
        """The pipeline as plain values, with every default; without `observers` if it has none.

        Variables that may be secret are as written, see `Settings.public`.

        Args:
            escaped: applied to all other values.
        """
        tree: dict[str, Any] = {"name": escaped(self.name)}
        if self.protocol is not None:
            tree["protocol"] = escaped(self.protocol.written)
        for point in PIPELINE_POINTS:
            written = [_written(item, escaped) for item in self.items[point.section]]
            if point.observes and not written:
                continue  # as in pipelines before observers existed
            bare = point.holds == "one" or (point.holds == "one or list" and len(written) < 2)
            tree[point.section] = (written[0] if written else None) if bare else written
        tree["training"] = training = self.training.model_dump(mode="json")
        if self.training.learning_rates.views is None:
            del training["learning_rates"]["views"]  # as in pipelines before `views` existed
        if self.iterations_per_view is not None:
            training["iterations"] = f"{self.iterations_per_view} per view"
        return tree

    def to_yaml(self) -> str:
        """`plain` as a file; `parse_pipeline` reads the same pipeline back."""
        return to_yaml(self.plain(escape_variables))


def load_pipeline(
    path: Path,
    plugins: Plugins,
    *,
    overrides: Sequence[str] = (),
    disabled: Sequence[str] = (),
    needed: Collection[str] | None = None,
) -> Pipeline:
    """Read and check a pipeline file.

    Args:
        path: the file, or the name of a ready pipeline.
        needed: sections whose components must be installed; None: all.
        overrides: `a.b=value`, as for `--set`; applied before `disabled`.
        disabled: names of components to disable, as for `--disable`.

    Raises:
        PipelineError: the file or a change is wrong; with the line.
        PluginError: a component that it names cannot be loaded.
    """
    return checked_pipeline(read(find_pipeline(path)), plugins, overrides, disabled, needed)


def parse_pipeline(
    text: str,
    plugins: Plugins,
    *,
    source: str = "pipeline",
    overrides: Sequence[str] = (),
    disabled: Sequence[str] = (),
) -> Pipeline:
    """`load_pipeline` for YAML text; `source` stands for the file name in errors."""
    return checked_pipeline(parse(text, source), plugins, overrides, disabled)


def checked_pipeline(
    root: Node,
    plugins: Plugins,
    overrides: Sequence[str] = (),
    disabled: Sequence[str] = (),
    needed: Collection[str] | None = None,
) -> Pipeline:
    """`load_pipeline` for a tree that is already read; changes it in place."""
    if not isinstance(root.content, dict):
        raise root.place.error(
            f"a pipeline is a mapping of sections, not {root.kind}",
            fix=f"sections: {listing(TOP_LEVEL)}",
        )
    apply_overrides(root, overrides, plugins)
    for name in disabled:
        disable(root, name)
    sections = root.content
    for key, node in sections.items():
        check_section(key, node.place)
    protocol = apply_protocol(sections)
    absent = Node(None, root.place)
    training, each = read_training(sections.get("training", absent))
    missing: dict[str, ExplainedError] = {}
    items = {
        point.section: _section(
            point,
            sections.get(point.section, absent),
            plugins,
            training,
            None if needed is None or point.section in needed else missing,
        )
        for point in PIPELINE_POINTS
    }
    for loader in items[SCENE.section]:
        items["priors"] = with_named_priors(
            loader, items["priors"], plugins, None if needed is None else missing
        )
    named = sections.get("name", absent)
    name = plain(named)
    if not is_plain_name(name):
        raise named.place.error(
            "the pipeline needs a name, a visible text of at most 200 characters",
            fix="write for example `name: my-experiment` at the top",
        )
    return Pipeline(name, items, training, protocol, each, missing)


def _section(
    point: HookPoint,
    node: Node,
    plugins: Plugins,
    training: TrainingSettings,
    missing: dict[str, ExplainedError] | None,
) -> tuple[Item, ...]:
    """Return the items of a section; `missing` receives those that cannot be loaded; None: refuse them."""
    if point.holds == "one" and isinstance(node.content, list):
        raise node.place.error(
            f"{point.section} holds a single {point.title}, not a list",
            fix="write one component; set its `use` and settings without a dash",
        )
    if point.holds == "list" and not isinstance(node.content, list | None):
        raise node.place.error(
            f"{point.section} must be a list, not {node.kind}",
            fix=f"put a dash in front of each {point.title}",
        )
    written = [] if node.content is None else [node]
    items: dict[str, Item] = {}
    for component in node.content if isinstance(node.content, list) else written:
        try:
            item = _first_complete(point, component, plugins.find, training.iterations)
        except ExplainedError as error:
            if missing is None:
                raise
            keys = expand(component)
            name = next((plain(keys[key]) for key in ("name", "use") if key in keys), "?")
            missing[f"{point.section}.{name}"] = error
            continue
        if item is None:
            continue
        if item.name in items:
            named = expand(component).get("name", component)
            first = items[item.name].place
            raise named.place.error(
                f"two {point.section} are named {item.name!r}; the first is at {first}",
                fix="give one of them a `name` of its own",
            )
        items[item.name] = item
    if point.required and not items and missing is None:
        raise node.place.error(
            f"the pipeline has no {point.title}; one is required",
            fix=f"write {point.section}: {{use: ...}}; `stereogs plugins` lists all components",
        )
    return tuple(items.values())


def with_named_priors(
    loader: Item,
    priors: tuple[Item, ...],
    plugins: Plugins,
    missing: dict[str, ExplainedError] | None = None,
) -> tuple[Item, ...]:
    """Return the priors, and those that a scene loader names and only their packages offer.

    Args:
        missing: receives those that cannot be loaded; None: refuse them.

    Raises:
        ExplainedError: one cannot be loaded, or has another capability than the loader needs.
    """
    component = loader.offer.component
    named = component.priors_of(loader.settings) if issubclass(component, SceneLoader) else {}
    for name, capability in named.items():
        try:
            if all(item.name != name for item in priors):
                node = Node({"use": Node(name, loader.place)}, loader.place)
                item = component_item(PRIORS, node, plugins.find, 1)
                assert item is not None
                priors = (*priors, item)
            known = {
                item.name: getattr(item.offer.component, "capability", None) for item in priors
            }
            chosen_prior(known, (capability,), name)
        except ExplainedError as error:
            error.where = error.where or str(loader)
            if missing is None:
                raise
            missing.setdefault(f"priors.{name}", error)
    return priors


def _first_complete(point: HookPoint, node: Node, find: Find, iterations: int) -> Item | None:
    """`component_item`; of a prior with `fallbacks`, the first that has its files, or else the last.

    A setting from the command line or an ablation selects the prior: a wrong path is then an error.
    """
    written = expand(node).get("fallbacks") if point.section == "priors" else None
    if written is None:
        return component_item(point, node, find, iterations)
    others = written.content
    if not isinstance(others, list) or not others:
        fix = "write `fallbacks: [NAME, {use: NAME, ...}]`, best first"
        raise written.place.error(f"fallbacks is a list of priors, not {written.kind}", fix=fix)
    preferred = {key: child for key, child in expand(node).items() if key != "fallbacks"}
    shared = {"name": preferred.get("name", preferred.get("use", node))}
    if "enabled" in preferred:
        shared["enabled"] = preferred["enabled"]
    candidates = [Node(preferred, node.place)]
    if all(child.place.source == node.place.source for child in preferred.values()):
        candidates += [Node({**expand(other), **shared}, other.place) for other in others]
    lacking: list[str] = []
    for candidate in candidates:
        try:
            plain(candidate)
        except PipelineError as unset_variable:
            lacking.append(unset_variable.what)
            continue
        item = component_item(point, candidate, find, iterations)
        paths = list(paths_of(item.settings)) if item else []
        absent = [shown for path, shown in paths if not path.expanduser().exists()]
        if item is None or (not absent and not lacking):
            return item
        if not absent:
            files = "".join(f" with {Path(shown).name}" for _, shown in paths)
            why = "; ".join(dict.fromkeys(lacking))
            return replace(item, fallback=f"{item.name} is {item.host.use}{files}: {why}")
        lacking.append(f"{absent[0]} does not exist")
    return component_item(point, candidates[-1], find, iterations)


def component_item(point: HookPoint, node: Node, find: Find, iterations: int) -> Item | None:
    """Return the item of a component as it is written, or None if the component is disabled.

    Args:
        find: as `Plugins.find`.
        iterations: of the run; shares such as `50%` refer to it.
    """
    mapping = expand(node)
    names = point.host_settings
    label = point.section
    name = next((mapping[key].content for key in ("name", "use") if key in mapping), None)
    if point.holds != "one" and isinstance(name, str):
        label += f".{name}"
    written = in_iterations({k: v for k, v in mapping.items() if k in names}, iterations)
    if "use" not in mapping:
        near = next((key for key in mapping if did_you_mean(key, ["use"])), None)
        raise (mapping[near] if near else node).place.error(
            f"{label} does not say which {point.title} to use"
            + (f"; it says {near!r}, did you mean 'use'?" if near else ""),
            fix="add `use: NAME`; `stereogs plugins` lists the names",
        )
    place = mapping["use"].place
    host = validate_settings(HostSettings, Node(written, node.place), label)
    if not host.enabled:
        return None
    try:
        offer = find(point, host.use, packager(place.source))
    except PluginError as error:
        where = f"{place}; {error.where}" if error.where else str(place)
        raise PluginError(error.what, where=where, fix=error.fix) from error
    completed = with_defaults(written, host_defaults(offer, iterations))
    host = validate_settings(HostSettings, Node(completed, node.place), label)
    own = Node({k: v for k, v in mapping.items() if k not in names}, node.place)
    settings = validate_settings(offer.settings_type, own, label, names)
    host = host.model_copy(update={"use": offer.use})
    return Item(host.name or offer.name, settings, host, offer, place)


def host_defaults(offer: Offer, iterations: int) -> dict[str, Node]:
    """Return a component's defaults of settings that the host reads, in iterations."""
    place = Place(f"host_defaults of {offer}")
    written = offer.component.host_defaults.written()
    return in_iterations({name: Node(value, place) for name, value in written.items()}, iterations)


def default_schedule(offer: Offer, iterations: int) -> Schedule:
    """Return the schedule of a component whose pipeline gives none."""
    known = host_defaults(offer, iterations)
    names = known.keys() & Schedule.model_fields.keys()
    return Schedule.model_validate({name: known[name].content for name in names})


def _written(item: Item, escaped: Callable[[Any], Any]) -> dict[str, Any]:
    host = item.host.model_dump(mode="json")
    names = [n for n in item.point.host_settings if n not in ("enabled", "fallbacks")]
    first = {name: host[name] for name in names if name != "name" or host[name] is not None}
    return {**escaped(first), **recorded(item.settings, escaped)}
