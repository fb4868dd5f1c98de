"""`video`: a flight along a smooth path through the training views."""

from __future__ import annotations

from typing import TYPE_CHECKING

from pydantic import Field

from registry import Exporter, Register, Scene, Settings, hookimpl

if TYPE_CHECKING:
    from pathlib import Path

    from core_rasterizer import GaussianReader


class VideoSettings(Settings):
    frames: int = Field(120, ge=2)
    """Number of frames, at 30 frames per second."""


class VideoExporter(Exporter[VideoSettings]):
    """Writes flight.mp4, or numbered PNG files if the extra `video` is not installed."""

    def export(self, model: GaussianReader, scene: Scene, folder: Path) -> list[Path]:
        """Write the files and return their paths.

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
