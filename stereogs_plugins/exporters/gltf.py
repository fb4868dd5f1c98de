"""`gltf`: a binary glTF file with the ratified extension KHR_gaussian_splatting."""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING, Any

from registry import Exporter, Register, Scene, Settings, hookimpl

if TYPE_CHECKING:
    from pathlib import Path

    import numpy as np

    from core_rasterizer import GaussianReader, Gaussians

    Attributes = dict[str, np.ndarray[Any, Any]]

EXTENSION = "KHR_gaussian_splatting"
_TYPES = {1: "SCALAR", 3: "VEC3", 4: "VEC4"}
_FLOAT = 5126
_POINTS = 0
_JSON, _BINARY = 0x4E4F534A, 0x004E4942
"""Types of the two chunks of a GLB file (glTF 2.0, section 4.4)."""


class GltfExporter(Exporter[Settings]):
    """Writes scene.glb: positions, rotations, scales, opacities and spherical harmonics as float32.

    The values are in scene coordinates, or far from the origin relative to a point that the node adds; a
    node rotates them to glTF's axes, so that the first training camera
    is upright and looks along -z.
    """

    def export(self, model: GaussianReader, scene: Scene, folder: Path) -> list[Path]:
        """Write the file and return its path."""
        import numpy as np

        from registry.toolkit.drawing import upright_rotation

        path = folder / "scene.glb"
        rotation = upright_rotation([view.camera for view in scene.train])
        gaussians, origin = model.gaussians(), np.zeros(3)
        if gaussians.needs_double:  # the node's translation is a JSON number, in double precision
            center = gaussians.means.median(dim=0).values
            gaussians, origin = replace(gaussians, means=gaussians.means - center), center.numpy()
        values = attributes(gaussians)
        for name, further in model.attributes.items():  # glTF 2.0: a custom name begins with "_"
            values[f"_{name.upper()}"] = further[:, None].numpy()
        node = {"rotation": rotation.as_quat().tolist()}
        if origin.any():
            node["translation"] = rotation.apply(origin).tolist()
        _write_glb(values, node, path)
        return [path]


def attributes(gaussians: Gaussians) -> Attributes:
    """Return the extension's attributes by name, `[N, K]` float32 each.

    Rotations are unit quaternions (x, y, z, w), scales and opacities activated. Coefficient n of degree
    l is coefficient l^2 + n of the 3DGS PLY.
    """
    import torch
    from torch.nn.functional import normalize

    values = {
        "POSITION": gaussians.means.float(),
        f"{EXTENSION}:ROTATION": normalize(gaussians.quaternions, dim=1)[:, [1, 2, 3, 0]],
        f"{EXTENSION}:SCALE": gaussians.log_scales.exp(),
        f"{EXTENSION}:OPACITY": torch.sigmoid(gaussians.opacity_logits)[:, None],
    }
    for degree in range(gaussians.sh_degree + 1):
        for order in range(2 * degree + 1):
            name = f"{EXTENSION}:SH_DEGREE_{degree}_COEF_{order}"
            values[name] = gaussians.sh[:, degree * degree + order]
    return {name: value.contiguous().numpy() for name, value in values.items()}


def _write_glb(values: Attributes, node: dict[str, list[float]], path: Path) -> None:
    """Write one mesh of points with these attributes.

    Args:
        node: rotation (x, y, z, w) and translation of the mesh's node.
    """
    import json
    import struct

    blobs = [value.astype("<f4").tobytes() for value in values.values()]
    document = json.dumps(_document(values, node), separators=(",", ":")).encode()
    document += b" " * (-len(document) % 4)
    size = sum(map(len, blobs))
    with path.open("wb") as file:
        file.write(struct.pack("<4sII", b"glTF", 2, 12 + 8 + len(document) + 8 + size))
        file.write(struct.pack("<II", len(document), _JSON) + document)
        file.write(struct.pack("<II", size, _BINARY))
        file.writelines(blobs)


def _document(values: Attributes, node: dict[str, list[float]]) -> dict[str, Any]:
    views, accessors, offset = [], [], 0
    for index, value in enumerate(values.values()):
        views.append({"buffer": 0, "byteOffset": offset, "byteLength": value.nbytes})
        offset += value.nbytes
        accessors.append(
            {
                "bufferView": index,
                "componentType": _FLOAT,
                "count": len(value),
                "type": _TYPES[value.shape[1]],
            }
        )
    positions = values["POSITION"]  # the only attribute whose bounds glTF requires
    accessors[0] |= {"min": positions.min(axis=0).tolist(), "max": positions.max(axis=0).tolist()}
    primitive = {
        "mode": _POINTS,
        "attributes": {name: index for index, name in enumerate(values)},
        "extensions": {EXTENSION: {"kernel": "ellipse", "colorSpace": "srgb_rec709_display"}},
    }
    return {
        "asset": {"version": "2.0", "generator": "StereoGS plugins"},
        "extensionsUsed": [EXTENSION],
        "scene": 0,
        "scenes": [{"nodes": [0]}],
        "nodes": [{"mesh": 0, **node}],
        "meshes": [{"primitives": [primitive]}],
        "accessors": accessors,
        "bufferViews": views,
        "buffers": [{"byteLength": offset}],
    }


@hookimpl
def stereogs_register_exporters(register: Register[GltfExporter]) -> None:
    register("gltf", GltfExporter)
