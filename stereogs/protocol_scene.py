"""A folder as a protocol reads it, and folders for other programs."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING

from registry import Scene, SceneError
from registry.discovery import Plugins
from registry.messages.suggestions import listing
from registry.pipeline.edits import SECTIONS
from registry.pipeline.pipeline import Pipeline
from registry.pipeline.protocols import load_protocol
from registry.pipeline.settings_check import escape_variables
from registry.recognition import recognizing

from .session import build_pipeline

if TYPE_CHECKING:
    from core_rasterizer import Gaussians


def pipeline_of(protocol: str, folder: Path | None = None, changes: Sequence[str] = ()) -> Pipeline:
    """Return a pipeline that loads a folder by a protocol, and has its metrics.

    Args:
        folder: folder of the scene; None if only the metrics are used.

    Raises:
        SceneError: no loader of the protocol recognizes the folder.
        PipelineError: a change contradicts the protocol.
    """
    if folder is None:
        scene = {"use": next(iter(load_protocol(protocol).loaders)), "path": "none"}
    else:
        scene = {"use": loader_of(protocol, folder), "path": escape_variables(str(folder))}
    return build_pipeline(
        {
            "name": protocol,
            "protocol": protocol,
            "scene": scene,
            "initializer": "random",
        },
        changes,
    )


def loader_of(protocol: str, folder: Path) -> str:
    """Return the loader of a protocol that recognizes a folder.

    Raises:
        SceneError: none does.
    """
    loaders = load_protocol(protocol).loaders
    found = [offer.name for offer in recognizing(folder, Plugins())] if folder.is_dir() else []
    known = [name for name in loaders if name in found]
    if not known:
        raise SceneError(
            f"no loader of the protocol {protocol!r} reads this folder",
            where=str(folder),
            fix=f"give a folder with the layout of {listing(loaders)}; see `stereogs data`",
        )
    return known[0]


def write_scene(scene: Scene, layout: str, folder: Path) -> list[Path]:
    """Write photographs, masks, cameras and points as a folder that other programs read.

    Args:
        layout: name of an exporter that writes scenes, "colmap" or "transforms"; also of the new folder.

    Returns:
        The files.
    """
    from core_rasterizer import GaussianReader, open_device
    from registry.calls.copies import copied
    from registry.pipeline.parts import build_part
    from registry.pipeline.single_item import single_item
    from registry.pipeline.training_settings import TrainingSettings
    from registry.training.initial_model import new_model

    device = open_device()
    part = build_part(single_item(Plugins().find(SECTIONS["exporters"], layout)), 0, device)
    # The exporters of scenes do not read the Gaussians.
    model = new_model(_one_gaussian(), TrainingSettings(), device)
    files: list[Path] = part.call(GaussianReader(model), copied(scene), folder)
    return files


def _one_gaussian() -> Gaussians:
    import torch

    from core_rasterizer import Gaussians

    return Gaussians(
        means=torch.zeros(1, 3),
        log_scales=torch.zeros(1, 3),
        quaternions=torch.tensor([[1.0, 0.0, 0.0, 0.0]]),
        opacity_logits=torch.zeros(1),
        sh=torch.zeros(1, 1, 3),
    )
