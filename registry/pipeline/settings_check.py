"""Settings from YAML, validated by pydantic; errors give the line and a fix."""

from __future__ import annotations

import json
import logging
import os
import re
from collections.abc import Callable, Collection, Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any, TypeVar, get_args

import pydantic

from ..contract.component import Settings
from ..messages.suggestions import did_you_mean, listing
from ..toolkit.cache.remote import local_copy, url_of
from ..toolkit.networks.model_file import MODELS_VARIABLE
from .yaml_source import Node, Place

_log = logging.getLogger("stereogs.pipeline")
Model = TypeVar("Model", bound=Settings)
PUBLIC_PREFIX = "STEREOGS_"
"""Environment variables whose names begin so hold no secret."""
_VARIABLE = re.compile(r"\$\$\{|\$\{([^}]*)(\}?)")
_MESSAGES = {
    "int_type": "must be a whole number",
    "float_type": "must be a number",
    "bool_type": "must be true or false",
    "model_type": "must be a mapping of settings",
    "string_type": "must be text; numbers, true, false and null need quotes to be text",
}


def validate_settings(
    model: type[Model], node: Node, path: str, host_names: Sequence[str] = ()
) -> Model:
    """Build a settings model from a mapping.

    Types are strict: "3" is not a number, 3.0 is not a whole number, `yes` is not true.

    Args:
        node: the mapping; `${NAME}` in its texts is replaced by the environment variable.
        path: the mapping's place in the pipeline, for messages, for example "scene".
        host_names: further names that the section may contain, which the host reads.

    Raises:
        PipelineError: unknown names (with the nearest known one), wrong types or values, an
            environment variable that is not set. Reports all mistakes of the mapping. Also a setting under
            its former and its present name, and a removed setting with another value than the code has.
    """
    node = _up_to_date(model, node, path)
    # Through JSON, pydantic's strict types still take a list as a tuple and text as a path.
    text = json.dumps(plain(node))
    try:
        settings = model.model_validate_json(text, strict=True)
        for name, written in _kept_as_written(node, model.public).items():
            settings._written[name] = getattr(settings, name), written
        return settings
    except pydantic.ValidationError as error:
        # A missing setting is often a misspelt one: report the misspelt name first.
        found = sorted(error.errors(), key=lambda problem: problem["type"] == "missing")
    problems = list(
        dict.fromkeys(_explain(problem, model, node, path, host_names) for problem in found)
    )
    place, what, _ = problems[0]
    if len(problems) > 1:
        lines = [f"  {place}: {message}" for place, message, _ in problems]
        what = "\n".join([f"{len(problems)} settings are wrong:", *lines])
    raise place.error(what, fix="\n".join(dict.fromkeys(fix for _, _, fix in problems)))


def _up_to_date(model: type[Settings], node: Node, path: str) -> Node:
    """Return settings under their present names and without removed ones, also in nested settings."""
    if not isinstance(node.content, dict):
        return node
    current: dict[str, Node] = {}
    for key, child in node.content.items():
        if key in model.removed:
            _check_removed(model.removed[key], child, f"{path}.{key}")
            continue
        name = model.renamed.get(key, key)
        if name != key:
            if name in node.content:
                what = (
                    f"{path} has {key!r} and {name!r}, the former and the present name of a setting"
                )
                raise child.place.error(what, fix=f"remove {key!r}")
            _log.warning("%s: the setting %s.%s is now called %s", child.place, path, key, name)
        field = model.model_fields.get(name)
        nested = _settings_in(field.annotation) if field else None
        current[name] = _up_to_date(nested, child, f"{path}.{name}") if nested else child
    return Node(current, node.place)


def _check_removed(value: object, written: Node, path: str) -> None:
    if plain(written) != value:
        raise written.place.error(
            f"the setting {path} was removed; its value is always {value!r}, not {written.kind}",
            fix=f"remove {path.rpartition('.')[2]!r}",
        )


def plain(node: Node) -> Any:
    """Return a node as plain dicts, lists and scalars, with environment variables filled in.

    Raises:
        PipelineError: a variable is not set, or its `}` is missing.
    """
    content = node.content
    if isinstance(content, dict):
        return {key: plain(child) for key, child in content.items()}
    if isinstance(content, list):
        return [plain(child) for child in content]
    return _expand_variables(content, node.place) if isinstance(content, str) else content


def escape_variables(value: Any) -> Any:
    """The inverse of the expansion for plain values: `${` is written as `$${`."""
    if isinstance(value, dict):
        return {key: escape_variables(child) for key, child in value.items()}
    if isinstance(value, list):
        return [escape_variables(child) for child in value]
    return value.replace("${", "$${") if isinstance(value, str) else value


def recorded(
    settings: Settings, escaped: Callable[[Any], Any] = lambda value: value
) -> dict[str, Any]:
    """Return settings as JSON values for run folders and displays, without values that may be secret.

    Args:
        escaped: applied to each value that is not as written.
    """
    values = settings.model_dump(mode="json")
    written = _as_written(settings)
    return {k: written.get(k, escaped(value)) for k, value in values.items()}


def with_path(settings: Model, name: str, path: Path) -> Model:
    """Return settings with another path, which are recorded as before."""
    kept = recorded(settings)[name]
    changed = settings.model_copy(update={name: path})
    changed._written = {**settings._written, name: (path, kept)}
    return changed


def with_local_copies(settings: Model) -> Model:
    """Return settings with local copies of remote data; they are recorded as before."""
    for name, value in settings:
        if isinstance(value, Path) and url_of(value):
            settings = with_path(settings, name, local_copy(value))
    return settings


def _as_written(settings: Settings) -> dict[str, Any]:
    """Return the settings that are recorded as written, unless they were changed since."""
    return {k: w for k, (v, w) in settings._written.items() if getattr(settings, k) == v}


def paths_of(settings: Settings) -> Iterator[tuple[Path, str]]:
    """Yield each path in settings that is not a URL, and how to show it."""
    written = _as_written(settings)
    for name, value in settings:
        for path in leaves(value, Path):
            if url_of(path) is None:
                yield path, str(written.get(name, path))


def leaves(value: Any, kind: type) -> Iterator[Any]:
    """Yield every value of a type, also in mappings and sequences."""
    if isinstance(value, kind):
        yield value
    elif isinstance(value, Mapping | list | tuple):
        for inner in value.values() if isinstance(value, Mapping) else value:
            yield from leaves(inner, kind)


def _kept_as_written(node: Node, public: Collection[str]) -> dict[str, Any]:
    """Return the settings with a variable that may be secret, or with a URL, whose slashes a path merges."""
    children = node.content if isinstance(node.content, dict) else {}
    written = {k: child.as_written() for k, child in children.items() if k not in public}
    return {k: v for k, v in written.items() if any(map(_is_kept, leaves(v, str)))}


def _is_kept(text: str) -> bool:
    return _is_private(text) or url_of(text) is not None


def _is_private(text: str) -> bool:
    names = [match.group(1) for match in _VARIABLE.finditer(text)]
    return any(name is not None and not name.startswith(PUBLIC_PREFIX) for name in names)


def _expand_variables(text: str, place: Place) -> str:
    def value(match: re.Match[str]) -> str:
        name = match.group(1)
        if name is None:
            return "${"
        if not match.group(2):
            raise place.error(
                f"the variable in {text[:100]!r} is not closed",
                fix="write ${NAME}; $${ stands for these two characters themselves",
            )
        if name not in os.environ:
            fix = f"set it: export {name}=..."
            if name == MODELS_VARIABLE:
                fix += "; `stereogs models` lists the networks that belong there"
            raise place.error(f"the environment variable {name!r} is not set", fix=fix)
        return os.environ[name]

    return _VARIABLE.sub(value, text)


def _explain(
    problem: Any, model: type[Settings], node: Node, path: str, host_names: Sequence[str]
) -> tuple[Place, str, str]:
    """Return place, message and fix of one of pydantic's errors."""
    location: tuple[str | int, ...] = problem["loc"]
    kind, written = problem["type"], node.at(location)
    # A value of a nested model, such as `training.learning_rates: 3`, is not a field of that model.
    fields = _model_at(model, location[:-1]).model_fields
    names = [*fields, *(host_names if len(location) <= 1 else ())]
    where = ".".join([path, *map(str, location)])
    section = ".".join([path, *map(str, location[:-1])])
    if kind == "extra_forbidden":
        name = str(location[-1])
        message = f"{section} has no setting {name!r}{did_you_mean(name, names)}"
    elif kind == "missing":
        message = f"{section} needs the setting {str(location[-1])!r}"
    elif kind in ("value_error", "assertion_error"):
        message = f"{where}: {problem.get('ctx', {}).get('error', problem['msg'])}"
    elif kind in _MESSAGES:
        message = f"{where} {_MESSAGES[kind]}, not {written.kind}"
    else:
        message = f"{where}: {problem['msg'][:1].lower()}{problem['msg'][1:]}, not {written.kind}"
    return written.place, message, f"settings: {listing(names)}"


def _model_at(model: type[Settings], location: tuple[str | int, ...]) -> type[Settings]:
    """Return the innermost settings model on the way to a location."""
    for step in location:
        field = model.model_fields.get(str(step))
        model = (_settings_in(field.annotation) if field else None) or model
    return model


def _settings_in(annotation: Any) -> type[Settings] | None:
    """Return the first settings model in a type, such as a member of a union."""
    if isinstance(annotation, type) and issubclass(annotation, Settings):
        return annotation
    return next(filter(None, map(_settings_in, get_args(annotation))), None)
