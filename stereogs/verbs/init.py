"""Write a commented pipeline to start from."""

from __future__ import annotations

import argparse
import inspect
import re
import textwrap
from pathlib import Path
from typing import TYPE_CHECKING

from registry import PluginError
from registry.toolkit.cache.remote import on_this_machine

from ..command_line.command import Command
from ..command_line.output import console

if TYPE_CHECKING:
    from collections.abc import Iterator

    from registry.contract.hook_points import HookPoint
    from registry.discovery import Plugins

WIDTH = 100
"""Columns of the file."""
CHOSEN = {
    "scene": "procedural",
    "initializer": "{use: consistency_dense, stride: 3}",
    "priors": "[plane_sweep]",
    "densification": "gradient_threshold",
    "opacity": "gradient_aware_decay",
    "metrics": "[psnr, ssim]",
    "exporters": "[ply]",
    "reports": "[html]",
}
"""Content of the sections; the others are empty."""
TRAINING = {
    "iterations": 1000,
    "seed": 0,
    "sh_degree": 1,
    "sh_every": 300,
    "max_gaussians": 200_000,
}

_EPILOG = """\
examples:
  stereogs init mine                          writes mine.yaml
  stereogs train mine.yaml                    trains it on a synthetic room
  stereogs train mine.yaml --scene my-photos  on your photographs, or a data set

The file has every section, with the names of all installed components as comments. An existing file is
never replaced. To start from a published method, copy its file instead: `stereogs explain methods/fsgs`
prints it in full.
"""
_HEAD = """\
# A pipeline to start from; as written, it trains on a synthetic room.
#
#   {train:{width}}  on photographs or a data set instead
#   {explain:{width}}  which component is called when, and all settings
#   {plugins:{width}}  what a component does, its settings and their defaults
#
# Above each section are its purpose and the other components that it can hold. A bare name takes the
# component's defaults, with its published schedule as a share of the run; to change them, write for
# example {{use: dropout, rate: 0.2, start: 10%}}.
"""


class Init(Command):
    epilog = _EPILOG

    def add_arguments(self, parser: argparse.ArgumentParser) -> None:
        parser.add_argument("name", metavar="NAME", help="of the pipeline; the file is NAME.yaml")

    def run(self, arguments: argparse.Namespace) -> int:
        """Write the file and print the next command."""
        from registry.discovery import Plugins

        path = on_this_machine(arguments.name.removesuffix(".yaml") + ".yaml")
        content = text(path, Plugins())
        try:
            with path.open("x", encoding="utf-8") as file:
                file.write(content)
        except FileExistsError as error:
            raise PluginError(
                "the file exists", where=str(path), fix="choose another name, or move the file away"
            ) from error
        console().print(f"wrote {path}; next: stereogs train {path} --scene FOLDER")
        return 0


def text(path: Path, plugins: Plugins) -> str:
    """Return the content of the file."""
    from registry.contract.hook_points import HOOK_POINTS
    from registry.pipeline.yaml_source import to_yaml

    verbs = {
        "train": f"stereogs train {path} --scene FOLDER",
        "explain": f"stereogs explain {path}",
        "plugins": "stereogs plugins NAME",
    }
    lines = [
        _HEAD.format(**verbs, width=max(map(len, verbs.values()))),
        to_yaml({"name": path.stem}),
    ]
    for point in HOOK_POINTS:
        if point.in_pipeline:
            names = [offer.name for offer in plugins.all() if offer.point is point]
            lines += [*_section(point, names), ""]
    return "\n".join([*lines, *_training(), ""])


def _section(point: HookPoint, names: list[str]) -> Iterator[str]:
    """Yield a section: its purpose, the names that it does not use, and its content."""
    content = CHOSEN.get(point.section, "[]")
    purpose = inspect.cleandoc(point.base.__doc__ or "").partition("\n")[0]
    used = re.findall(r"\w+", content)
    others = ", ".join(name for name in names if name not in used)
    yield from _comment(f"{purpose} {'Also' if used else 'Any of'}: {others or 'none'}.")
    yield f"{point.section}: {content}"


def _training() -> Iterator[str]:
    from registry.pipeline.training_settings import TrainingSettings

    yield "training:"
    for name, value in TRAINING.items():
        described = TrainingSettings.model_fields[name].description or ""
        yield from _comment(" ".join(described.split()), indent="  ")
        yield f"  {name}: {value}"


def _comment(words: str, indent: str = "") -> list[str]:
    start = f"{indent}# "
    return textwrap.wrap(
        words, WIDTH, initial_indent=start, subsequent_indent=start, break_on_hyphens=False
    )
