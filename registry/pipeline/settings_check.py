"""Typed settings from YAML: pydantic decides, and its errors become ones with a line and a fix."""

from __future__ import annotations

import json
import os
import re
from collections.abc import Callable, Sequence
from typing import Any, TypeVar, get_args

import pydantic

from ..contract.component import Settings
from ..errors import PipelineError
from ..messages.suggestions import did_you_mean, listing
from .yaml_source import Node, Place

Model = TypeVar("Model", bound=Settings)
_VARIABLE = re.compile(r"\$\$\{|\$\{([^}]*)(\}?)")
_MESSAGES = {
    "int_type": "must be a whole number",
    "float_type": "must be a number",
    "bool_type": "must be true or false",
    "model_type": "must be a mapping of settings",
    "string_type": "must be text; numbers, true, false and null need quotes to be text",
}


def validate_settings(model: type[Model], node: Node, path: str, lent: Sequence[str] = ()) -> Model:
    """Build a settings model from a mapping.

    Types are strict: "3" is not a number, 3.0 is not a whole number, `yes` is not true.

    Args:
        node: the mapping; `${NAME}` in its texts is replaced by the environment variable.
        path: the mapping's place in the pipeline, for messages, for example "scene".
        lent: further names that may stand beside these, which the host reads itself.

    Raises:
        PipelineError: unknown names (with the nearest known one), wrong types or values, an
            environment variable that is not set. All mistakes of the mapping at once.
    """
    # Through JSON, pydantic's strict types still take a list as a tuple and text as a path.
    text = json.dumps(plain(node))
    try:
        return model.model_validate_json(text, strict=True)
    except pydantic.ValidationError as error:
        # A setting that is missing is often the one that another name was meant for.
        found = sorted(error.errors(), key=lambda problem: problem["type"] == "missing")
        problems = [_explain(problem, model, node, path, lent) for problem in found]
    raise _joined(problems)


def plain(node: Node) -> Any:
    """A node as plain dicts, lists and scalars, with environment variables filled in.

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


def _expand_variables(text: str, place: Place) -> str:
    def value(match: re.Match[str]) -> str:
        name = match.group(1)
        if name is None:
            return "${"
        if not match.group(2):
            raise PipelineError(
                f"the variable in {text[:100]!r} is not closed",
                where=str(place),
                fix="write ${NAME}; $${ stands for these two characters themselves",
            )
        if name not in os.environ:
            raise PipelineError(
                f"the environment variable {name!r} is not set",
                where=str(place),
                fix=f"set it (export {name}=...), or override this setting with --set",
            )
        return os.environ[name]

    return _VARIABLE.sub(value, text)


def _explain(
    problem: Any, model: type[Settings], node: Node, path: str, lent: Sequence[str]
) -> tuple[Place, str, str]:
    """One of pydantic's errors as place, message and fix."""
    location: tuple[str | int, ...] = problem["loc"]
    kind, context = problem["type"], problem.get("ctx", {})
    owner = _model_at(model, location[:-1])
    # A value that is itself a model's, such as `training.learning_rates: 3`, has fields of its own.
    names = [*owner.model_fields, *(lent if len(location) <= 1 else ())]
    where = _dotted(path, location)
    fix = f"settings: {listing(names)}"
    if kind == "extra_forbidden":
        name = str(location[-1])
        section = _dotted(path, location[:-1])
        message = f"{section} has no setting {name!r}{did_you_mean(name, names)}"
    elif kind == "missing":
        message = f"{_dotted(path, location[:-1])} needs the setting {str(location[-1])!r}"
    elif kind in ("value_error", "assertion_error"):
        message = f"{where}: {context.get('error', problem['msg'])}"
    elif kind in _MESSAGES:
        message = f"{where} {_MESSAGES[kind]}, not {node.at(location).kind}"
    else:
        message = f"{where}: {_decapitalized(problem['msg'])}, not {node.at(location).kind}"
    return node.at(location).place, message, fix


def _joined(problems: list[tuple[Place, str, str]]) -> PipelineError:
    distinct = list(dict.fromkeys(problems))
    if len(distinct) == 1:
        place, message, fix = distinct[0]
        return PipelineError(message, where=str(place), fix=fix)
    lines = "\n".join(f"  {place}: {message}" for place, message, _ in distinct)
    return PipelineError(
        f"{len(distinct)} settings are wrong:\n{lines}",
        where=str(distinct[0][0]),
        fix="\n".join(dict.fromkeys(fix for _, _, fix in distinct)),
    )


def _model_at(model: type[Settings], location: tuple[str | int, ...]) -> type[Settings]:
    """The settings model that a location points into, as far as fields lead there."""
    for step in location:
        field = model.model_fields.get(str(step))
        nested = _first(field.annotation, _is_model) if field else None
        if nested is None:
            continue
        model = nested
    return model


def _is_model(annotation: Any) -> bool:
    return isinstance(annotation, type) and issubclass(annotation, Settings)


def _first(annotation: Any, accept: Callable[[Any], bool]) -> Any:
    """The first part of a type, such as a member of a union, that is accepted."""
    if accept(annotation):
        return annotation
    parts = (_first(part, accept) for part in get_args(annotation))
    return next((part for part in parts if part is not None), None)


def _dotted(path: str, location: tuple[str | int, ...]) -> str:
    return ".".join([path, *map(str, location)])


def _decapitalized(text: str) -> str:
    return text[:1].lower() + text[1:]
