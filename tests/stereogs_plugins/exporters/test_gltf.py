from __future__ import annotations

import json
import struct
from pathlib import Path
from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from core_rasterizer import GaussianModel, Gaussians, open_device
from stereogs_plugins.exporters.gltf import GltfExporter, stereogs_register_exporters
from tests.stereogs_plugins.building import build, offered
from tests.stereogs_plugins.exporters.looking import SCENE, colorful, likeness

NAME = "KHR_gaussian_splatting"


def exported(gaussians: Gaussians, folder: Path) -> Path:
    model = GaussianModel(gaussians, open_device())
    (file,) = build(GltfExporter).export(model.reader(), SCENE, folder)
    return file


def read_glb(file: Path) -> tuple[dict[str, Any], bytes]:
    """The two chunks of a GLB file, by the glTF 2.0 specification."""
    content = file.read_bytes()
    magic, version, length = struct.unpack_from("<4sII", content)
    assert (magic, version, length) == (b"glTF", 2, len(content))
    size, kind = struct.unpack_from("<I4s", content, 12)
    assert (kind, size % 4) == (b"JSON", 0)
    binary_size, binary_kind = struct.unpack_from("<I4s", content, 20 + size)
    assert (binary_kind, 28 + size + binary_size) == (b"BIN\0", length)
    return json.loads(content[20 : 20 + size]), content[28 + size :]


def values(document: dict[str, Any], binary: bytes, attribute: str) -> NDArray[np.float32]:
    (primitive,) = document["meshes"][0]["primitives"]
    accessor = document["accessors"][primitive["attributes"][attribute]]
    view = document["bufferViews"][accessor["bufferView"]]
    assert accessor["componentType"] == 5126
    width = {"SCALAR": 1, "VEC3": 3, "VEC4": 4}[accessor["type"]]
    assert view["byteLength"] == 4 * width * accessor["count"]
    flat = np.frombuffer(binary, "<f4", width * accessor["count"], view["byteOffset"])
    return flat.reshape(-1, width)


def read_gaussians(file: Path, degree: int) -> Gaussians:
    """As the extension's specification defines its attributes."""
    document, binary = read_glb(file)
    names = [f"{NAME}:SH_DEGREE_{d}_COEF_{n}" for d in range(degree + 1) for n in range(2 * d + 1)]
    attributes = set(document["meshes"][0]["primitives"][0]["attributes"])
    others = {"POSITION", f"{NAME}:ROTATION", f"{NAME}:SCALE", f"{NAME}:OPACITY"}
    assert attributes == others | set(names)
    x, y, z, w = values(document, binary, f"{NAME}:ROTATION").T
    opacity = torch.tensor(values(document, binary, f"{NAME}:OPACITY")[:, 0])
    return Gaussians(
        means=torch.tensor(values(document, binary, "POSITION")),
        log_scales=torch.tensor(values(document, binary, f"{NAME}:SCALE")).log(),
        quaternions=torch.tensor(np.stack([w, x, y, z], axis=1)),
        opacity_logits=torch.logit(opacity),
        sh=torch.tensor(np.stack([values(document, binary, name) for name in names], axis=1)),
    )


def test_is_offered_as_gltf() -> None:
    assert offered(stereogs_register_exporters) == {"gltf": GltfExporter}


def test_what_is_read_by_the_specification_looks_the_same(tmp_path: Path) -> None:
    gaussians = colorful()
    again = read_gaussians(exported(gaussians, tmp_path), 3)
    assert likeness(gaussians, again) > 80
    assert torch.allclose(again.quaternions.norm(dim=1), torch.ones(len(again)), atol=1e-6)


def test_only_the_stored_bands_are_written(tmp_path: Path) -> None:
    full = colorful(5)
    plain = Gaussians(**{**vars(full), "sh": full.sh[:, :4]})
    assert torch.equal(read_gaussians(exported(plain, tmp_path), 1).sh, plain.sh)


def test_the_file_says_what_the_extension_demands(tmp_path: Path) -> None:
    gaussians = colorful(9)
    document, _ = read_glb(exported(gaussians, tmp_path))
    (primitive,) = document["meshes"][0]["primitives"]
    assert document["extensionsUsed"] == [NAME]
    assert primitive["mode"] == 0
    kernel = {"kernel": "ellipse", "colorSpace": "srgb_rec709_display"}
    assert primitive["extensions"][NAME] == kernel
    position = document["accessors"][primitive["attributes"]["POSITION"]]
    assert position["min"] == gaussians.means.amin(dim=0).tolist()
    assert position["max"] == gaussians.means.amax(dim=0).tolist()


def test_the_node_turns_the_first_camera_upright(tmp_path: Path) -> None:
    """glTF: y is up. The tiny scene's cameras look along +z with -y up."""
    document, _ = read_glb(exported(colorful(5), tmp_path))
    rotation = Rotation.from_quat(document["nodes"][0]["rotation"])
    np.testing.assert_allclose(rotation.apply([0, -1, 0]), [0, 1, 0], atol=1e-12)
    np.testing.assert_allclose(rotation.apply([0, 0, 1]), [0, 0, -1], atol=1e-12)
