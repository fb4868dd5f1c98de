"""`html`: the scene and the report's 3D view as one page, scene.html, which opens from disk."""

from __future__ import annotations

from typing import TYPE_CHECKING

from registry import Exporter, Register, Scene, Settings, hookimpl
from registry.toolkit import write_text

if TYPE_CHECKING:
    from pathlib import Path

    from core_rasterizer import GaussianReader

FILE = "scene.html"


class HtmlExporter(Exporter[Settings]):
    """Writes scene.html, a page that shows the scene in 3D and loads no other file."""

    def export(self, model: GaussianReader, scene: Scene, folder: Path) -> list[Path]:
        """Write the page and return its path."""
        from registry.toolkit.web_page import page

        from .scene_view import licenses, pack, view_inside

        packed = pack(model.gaussians(), scene, model.dilation, model.compensate_dilation)
        content = f'<main class="alone">{view_inside(packed).content}{licenses()}</main>'
        write_text(folder / FILE, page(scene.name, [content]))
        return [folder / FILE]


@hookimpl
def stereogs_register_exporters(register: Register[HtmlExporter]) -> None:
    register("html", HtmlExporter)
