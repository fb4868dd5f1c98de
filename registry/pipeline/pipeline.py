"""A pipeline: which components, with which settings, in which order. From YAML, checked, and back."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, field, replace
from fractions import Fraction
from pathlib import Path
from typing import Any

from ..contract.component import Settings
from ..contract.hook_points import PIPELINE_POINTS, HookPoint
from ..errors import PipelineError, PluginError
from ..messages.suggestions import did_you_mean, listing
from ..plugins.discovery import Offer, Plugins
from .edits import TOP_LEVEL, apply_overrides, disable, expand
from .protocol_rules import AppliedProtocol, apply_protocol
from .ready import find_pipeline
from .schedule import HostSettings, Schedule, in_iterations
from .settings_check import escape_variables, plain, validate_settings
from .training_settings import TrainingSettings, iterations_of_a_run, per_view, plain_training
from .yaml_source import Node, Place, parse, read, to_yaml


@dataclass(frozen=True)
class Item:
    """One component as a pipeline chose it.

    Args:
        name: unique in its section.
        settings: the component's own settings, complete.
        host: what the host lends: schedule, weight.
        offer: where the component comes from.
        place: where the pipeline names it.
    """

    name: str
    settings: Settings
    host: HostSettings
    offer: Offer = field(compare=False)
    place: Place = field(compare=False)

    @property
    def point(self) -> HookPoint:
        """The hook point that it fills."""
        return self.offer.point

    @property
    def schedule(self) -> Schedule:
        """When it is due."""
        return self.host

    @property
    def qualified_name(self) -> str:
        """Unique in the pipeline, for example "regularizers.stereo_depth"."""
        return f"{self.point.section}.{self.name}"

    def scaled(self, factor: Fraction) -> Item:
        """The same in a run of another length."""
        return replace(self, host=self.host.scaled(factor)) if self.point.scheduled else self


@dataclass(frozen=True)
class Pipeline:
    """What a run does, complete and checked; only components that are enabled.

    Args:
        name: for titles and for the run folder.
        items: the components of each section, in the order of the file.
        training: the loop's settings.
        protocol: what fixes the split, the images and the metrics; None leaves them to the pipeline.
        iterations_per_view: what `for_views` goes by; None: the scene has no say in the length.
    """

    name: str
    items: dict[str, tuple[Item, ...]]
    training: TrainingSettings
    protocol: AppliedProtocol | None = None
    iterations_per_view: int | None = None

    def __iter__(self) -> Iterator[Item]:
        """All components, section by section."""
        return (item for section in self.items.values() for item in section)

    def one(self, section: str) -> Item:
        """The component of a section that holds exactly one: "scene" or "initializer"."""
        (item,) = self.items[section]
        return item

    def scaled(self, iterations: int) -> Pipeline:
        """The pipeline with so many iterations, and its schedules in proportion, rounded down.

        `--set training.iterations=N` moves only what is written as a share. Here moments that are written
        as numbers move too: what begins in iteration 100 of 400 begins in 50 of 200. What holds for the
        first iteration or for each one stays so.

        Args:
            iterations: >= 1.
        """
        factor = Fraction(iterations, self.training.iterations)
        if factor == 1:
            return replace(self, iterations_per_view=None)
        items = {
            section: tuple(item.scaled(factor) for item in items)
            for section, items in self.items.items()
        }
        training = self.training.scaled(iterations)
        return replace(self, items=items, training=training, iterations_per_view=None)

    def for_views(self, views: int) -> Pipeline:
        """The pipeline for so many training views: its length and rates are what it says for them."""
        if self.iterations_per_view is None:
            return self
        scaled = self.scaled(self.iterations_per_view * views)
        rates = scaled.training.learning_rates.for_views(views)
        return replace(
            scaled, training=scaled.training.model_copy(update={"learning_rates": rates})
        )

    def wrote(self, text: str) -> bool:
        """Whether a run of it, with however many training views, has such a pipeline file in its folder."""
        if self.iterations_per_view is None:
            return text == self.to_yaml()
        views = iterations_of_a_run(text) // self.iterations_per_view
        return views > 0 and text == self.for_views(views).to_yaml()

    def plain(self) -> dict[str, Any]:
        """The pipeline as plain values, every default written out; of observers nothing if it has none."""
        tree: dict[str, Any] = {"name": self.name}
        if self.protocol is not None:
            tree["protocol"] = self.protocol.written
        for point in PIPELINE_POINTS:
            written = [_written(item) for item in self.items[point.section]]
            if point.observes and not written:
                continue  # as in pipelines of before there were observers
            bare = point.holds == "one" or (point.holds == "one or list" and len(written) < 2)
            tree[point.section] = (written[0] if written else None) if bare else written
        tree["training"] = plain_training(self.training)
        if self.iterations_per_view is not None:
            tree["training"]["iterations"] = f"{self.iterations_per_view} per view"
        return tree

    def to_yaml(self) -> str:
        """`plain` as a file; `parse_pipeline` reads the same pipeline back."""
        return to_yaml(escape_variables(self.plain()))


def load_pipeline(
    path: Path,
    plugins: Plugins,
    *,
    overrides: Sequence[str] = (),
    disabled: Sequence[str] = (),
) -> Pipeline:
    """Read and check a pipeline file.

    Args:
        path: of the file, or the name of a ready pipeline.
        overrides: `a.b=value`, as for `--set`; applied before `disabled`.
        disabled: names of components to switch off, as for `--disable`.

    Raises:
        PipelineError: anything wrong with the file or the changes, with its line.
        PluginError: a component that it names cannot be loaded.
    """
    return build_pipeline(read(find_pipeline(path)), plugins, overrides, disabled)


def parse_pipeline(
    text: str,
    plugins: Plugins,
    *,
    source: str = "pipeline",
    overrides: Sequence[str] = (),
    disabled: Sequence[str] = (),
) -> Pipeline:
    """`load_pipeline` for YAML text; `source` stands for the file name in errors."""
    return build_pipeline(parse(text, source), plugins, overrides, disabled)


def build_pipeline(
    root: Node,
    plugins: Plugins,
    overrides: Sequence[str] = (),
    disabled: Sequence[str] = (),
) -> Pipeline:
    """`load_pipeline` for a tree that is read already; the changes are made in it."""
    if not isinstance(root.content, dict):
        raise PipelineError(
            f"a pipeline is a mapping of sections, not {root.kind}",
            where=str(root.place),
            fix=f"sections: {listing(TOP_LEVEL)}",
        )
    apply_overrides(root, overrides, plugins)
    for name in disabled:
        disable(root, name)
    sections = root.content
    for key, node in sections.items():
        if key not in TOP_LEVEL:
            raise PipelineError(
                f"a pipeline has no section {key!r}{did_you_mean(key, TOP_LEVEL)}",
                where=str(node.place),
                fix=f"sections: {listing(TOP_LEVEL)}",
            )
    protocol = apply_protocol(sections)
    written = sections.get("training", Node({}, root.place))
    if written.content is None:
        written = Node({}, written.place)
    own, each = per_view(_mapping(written, "training"))
    training = validate_settings(TrainingSettings, Node(own, written.place), "training")
    items = {
        point.section: _section(
            point, sections.get(point.section), root.place, plugins, training.iterations
        )
        for point in PIPELINE_POINTS
    }
    return Pipeline(_name(sections.get("name"), root.place), items, training, protocol, each)


def _name(node: Node | None, start: Place) -> str:
    name = plain(node) if node else None
    if not isinstance(name, str) or not name.strip():
        raise PipelineError(
            "the pipeline needs a name, a text",
            where=str(node.place if node else start),
            fix="write for example `name: my-experiment` at the top",
        )
    return name


def _section(
    point: HookPoint, node: Node | None, start: Place, plugins: Plugins, iterations: int
) -> tuple[Item, ...]:
    if node is None or node.content is None:
        written: list[Node] = []
    elif isinstance(node.content, list):
        if point.holds == "one":
            raise PipelineError(
                f"{point.section} holds a single {point.title}, not a list",
                where=str(node.place),
                fix="write one component; set its `use` and settings without a dash",
            )
        written = node.content
    elif point.holds != "list":
        written = [node]
    else:
        raise PipelineError(
            f"{point.section} must be a list, not {node.kind}",
            where=str(node.place),
            fix=f"put a dash in front of each {point.title}",
        )
    items: dict[str, Item] = {}
    for component in written:
        item = component_item(point, component, plugins.find, iterations)
        if item is None:
            continue
        if item.name in items:
            raise PipelineError(
                f"two {point.section} are named {item.name!r}; the first is at "
                f"{items[item.name].place}",
                where=str(expand(component).get("name", component).place),
                fix="give one of them a `name` of its own",
            )
        items[item.name] = item
    if point.required and not items:
        raise PipelineError(
            f"the pipeline has no {point.title}, and cannot do without",
            where=str(node.place if node else start),
            fix=f"write {point.section}: {{use: ...}}; `stereogs plugins` lists what there is",
        )
    return tuple(items.values())


def component_item(
    point: HookPoint, node: Node, find: Callable[[HookPoint, str], Offer], iterations: int
) -> Item | None:
    """One component as it is written, or None if it is switched off.

    Args:
        find: as `Plugins.find`.
        iterations: of the run, for shares of it.
    """
    mapping = expand(node)
    label = _label(point, mapping)
    lent_nodes = {k: v for k, v in mapping.items() if k in point.host_settings}
    host = Node(in_iterations(lent_nodes, iterations), node.place)
    lent = point.host_settings
    if "use" not in mapping:
        near = next((key for key in mapping if did_you_mean(key, ["use"])), None)
        raise PipelineError(
            f"{label} does not say which {point.title} to use"
            + (f"; it says {near!r}, did you mean 'use'?" if near else ""),
            where=str(mapping[near].place if near else node.place),
            fix="add `use: NAME`; `stereogs plugins` lists the names",
        )
    settings = validate_settings(HostSettings, host, label)
    if not settings.enabled:
        return None
    try:
        offer = find(point, settings.use)
    except PluginError as error:
        place = str(mapping["use"].place)
        where = f"{place}; {error.where}" if error.where else place
        raise PluginError(error.what, where=where, fix=error.fix) from error
    own = Node({k: v for k, v in mapping.items() if k not in lent}, node.place)
    return Item(
        name=settings.name or settings.use,
        settings=validate_settings(offer.settings_type, own, label, lent),
        host=settings,
        offer=offer,
        place=mapping["use"].place,
    )


def _label(point: HookPoint, mapping: dict[str, Node]) -> str:
    """The component's path in the pipeline, for messages: "scene", "regularizers.stereo_depth"."""
    if point.holds == "one":
        return point.section
    name = next((mapping[key].content for key in ("name", "use") if key in mapping), None)
    return f"{point.section}.{name}" if isinstance(name, str) else point.section


def _mapping(node: Node, name: str) -> dict[str, Node]:
    if not isinstance(node.content, dict):
        raise PipelineError(
            f"{name} must be a mapping of settings, not {node.kind}",
            where=str(node.place),
            fix=f"write each setting in a line of its own below `{name}:`",
        )
    return node.content


def _written(item: Item) -> dict[str, Any]:
    lent = item.host.model_dump(mode="json", include=set(item.point.host_settings))
    del lent["enabled"]
    if lent["name"] is None:
        del lent["name"]
    first = {key: lent[key] for key in item.point.host_settings if key in lent}
    return {**first, **item.settings.model_dump(mode="json")}
