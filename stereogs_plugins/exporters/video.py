"""`video`: a flight along a smooth path between the training views."""

from __future__ import annotations

from typing import TYPE_CHECKING

from pydantic import Field

from registry import Exporter, Register, Scene, Settings, hookimpl

if TYPE_CHECKING:
    from pathlib import Path

    from core_rasterizer import GaussianReader


class VideoSettings(Settings):
    frames: int = Field(120, ge=2)
    """Pictures of the flight; a second shows 30."""


class VideoExporter(Exporter[VideoSettings]):
    """Writes flight.mp4, or numbered PNG pictures where the extra `video` is not installed."""

    def export(self, model: GaussianReader, scene: Scene, folder: Path) -> list[Path]:
        """Write the file or the pictures and return the paths.

        Raises:
            RunError: the scene has one training view.
        """
        from registry.toolkit.drawing import smooth_path, write_video

        cameras = smooth_path([view.camera for view in scene.train], self.settings.frames)
        frames = (model.render(camera, background=scene.background).rgb for camera in cameras)
        written, _ = write_video(frames, folder / "flight")
        return sorted(written.iterdir()) if written.is_dir() else [written]


@hookimpl
def stereogs_register_exporters(register: Register[VideoExporter]) -> None:
    register("video", VideoExporter)
