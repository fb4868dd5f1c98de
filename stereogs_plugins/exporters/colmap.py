"""`colmap`: the photographs and their cameras as a COLMAP model."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from registry import Exporter, Register, Scene, Settings, hookimpl
from registry.toolkit import photos, write_text
from registry.toolkit.drawing import save_png

if TYPE_CHECKING:
    from pathlib import Path

    from core_rasterizer import Camera, GaussianReader
    from registry import View


class ColmapSettings(Settings):
    text: bool = False
    """Write the model as text instead of COLMAP's binary format."""


class ColmapExporter(Exporter[ColmapSettings]):
    """Writes colmap/images and colmap/sparse/0: PNG images, poses, intrinsics and the sparse points.

    sparse/0/test.txt lists the test views, in the format of the 3DGS code. Masks are in colmap/masks.
    """

    def export(self, model: GaussianReader, scene: Scene, folder: Path) -> list[Path]:
        """Write the files and return their paths."""
        images, sparse = folder / "colmap" / "images", folder / "colmap" / "sparse" / "0"
        for place in (images, sparse):
            place.mkdir(parents=True, exist_ok=True)
        written = []
        for view in (*scene.train, *scene.test):
            written.append(images / f"{view.name}.png")
            save_png(view.image, written[-1])
            if view.trained is not None:
                written.append(folder / "colmap" / "masks" / f"{view.name}.png.png")
                written[-1].parent.mkdir(exist_ok=True)
                save_png(255 * view.trained.byte(), written[-1])
        reconstruction = _reconstruction(scene)
        if self.settings.text:
            reconstruction.write_text(sparse)
        else:
            reconstruction.write_binary(sparse)
        write_text(sparse / "test.txt", "".join(f"{view.name}.png\n" for view in scene.test))
        return [*written, *sorted(sparse.iterdir())]


def _reconstruction(scene: Scene) -> Any:
    """Return a `pycolmap.Reconstruction`; views with equal intrinsics share a camera, points lack tracks."""
    pycolmap = photos.import_pycolmap()
    reconstruction = pycolmap.Reconstruction()
    cameras: dict[tuple[float, ...], int] = {}
    for number, view in enumerate((*scene.train, *scene.test), start=1):
        lens = _lens(view.camera)
        if lens not in cameras:
            cameras[lens] = len(cameras) + 1
            width, height, *parameters = lens
            reconstruction.add_camera_with_trivial_rig(
                pycolmap.Camera(
                    model="PINHOLE",
                    width=int(width),
                    height=int(height),
                    params=parameters,
                    camera_id=cameras[lens],
                )
            )
        _add_image(pycolmap, reconstruction, view, number, cameras[lens])
    if scene.points is not None:
        colors = (scene.points.colors * 255).round().byte().numpy()
        for position, color in zip(scene.points.positions.double().numpy(), colors, strict=True):
            reconstruction.add_point3D(position, pycolmap.Track(), color)
    return reconstruction


def _lens(camera: Camera) -> tuple[float, ...]:
    return (camera.width, camera.height, camera.fx, camera.fy, camera.cx, camera.cy)


def _add_image(pycolmap: Any, reconstruction: Any, view: View, number: int, camera: int) -> None:
    pose = view.camera.world_to_camera.numpy()
    image = pycolmap.Image(name=f"{view.name}.png", camera_id=camera, image_id=number)
    reconstruction.add_image_with_trivial_frame(
        image, pycolmap.Rigid3d(pycolmap.Rotation3d(pose[:3, :3]), pose[:3, 3])
    )


@hookimpl
def stereogs_register_exporters(register: Register[ColmapExporter]) -> None:
    register("colmap", ColmapExporter)
