"""Gaussians in PLY files, in the layout of 3D Gaussian Splatting.

One `vertex` element in binary little-endian float32: x y z, normals (zero), f_dc_0..2 (the constant
SH band), f_rest_* (the other bands, all of red, then green, then blue), opacity (logit), scale_0..2
(natural logarithm), rot_0..3 (w, x, y, z).
"""

from __future__ import annotations

import io
import logging
import os
import re
from collections.abc import Iterable, Mapping
from contextlib import suppress
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from ..errors import PlyError
from ..gaussians import SH_C0, Gaussians
from ..layout import MAX_LOGIT
from .header import CONVERT, read_header
from .overflow import without_overflow
from .values import MIN_LOG_SCALE, read_as_parameters

if TYPE_CHECKING:
    from plyfile import PlyData

    from .header import PlyHeader

_COMMENT = "SplatRenderMode: default"
"""Tells viewers that training used no anti-aliasing filter."""

_MIP, _FILTER = "SplatRenderMode: mip", "filter_3D"
"""A comment, and a property, of scenes trained with Mip-Splatting's filters."""

_MOVING = {"t", "mu_t", "scale_t", "scaling_t", "trbf_center", "motion_0", "velocity_0"}
"""Properties of Gaussians that move or fade in time (Spacetime Gaussians, 4DGS)."""
_MOTION = "delta_vertex"
"""Begin of the names of Brush's elements that move the vertices."""

_POSITION = ("x", "y", "z")
_NORMAL = ("nx", "ny", "nz")
_COLOR = ("red", "green", "blue")
_CONSTANT_BAND = ("f_dc_0", "f_dc_1", "f_dc_2")
_SCALE = ("scale_0", "scale_1", "scale_2")
_ROTATION = ("rot_0", "rot_1", "rot_2", "rot_3")
_REQUIRED = (*_POSITION, *_CONSTANT_BAND, "opacity", *_SCALE, *_ROTATION)
_REST = "f_rest_"
_REST_COUNTS = (0, 9, 24, 45)
"""Number of f_rest_* properties for SH degrees 0 to 3."""

_log = logging.getLogger(__name__)


def save_ply(
    gaussians: Gaussians, path: str | Path, attributes: Mapping[str, Tensor] | None = None
) -> int:
    """Write Gaussians to a PLY file, atomically: float32, and means far from the origin float64.

    Rows with a value that is not finite are omitted, because viewers fail on them.

    Args:
        path: the file; its folder must exist.
        attributes: further properties, `[N]` by name, which other programs ignore.

    Returns:
        Number of omitted rows; if any, a warning is logged.

    Raises:
        PlyError: the file cannot be written.
    """
    path = Path(path)
    count = len(gaussians)
    # [N, K, 3] to channel-major: all coefficients of red, then of green, then of blue.
    rest = gaussians.sh[:, 1:].transpose(1, 2).flatten(1)
    columns = torch.cat(
        [
            torch.zeros_like(gaussians.log_scales),
            gaussians.sh[:, 0],
            rest,
            gaussians.opacity_logits[:, None],
            gaussians.log_scales,
            gaussians.quaternions,
            *(values[:, None] for values in (attributes or {}).values()),
        ],
        dim=1,
    )
    columns = columns.detach().to("cpu", torch.float32)
    means = gaussians.means.detach().to("cpu")
    finite = torch.isfinite(columns).all(dim=1) & torch.isfinite(means).all(dim=1)
    dropped = count - int(finite.sum())
    if dropped:
        _log.warning("%s: omitted %d of %d Gaussians that are not finite", path, dropped, count)
        columns, means = columns[finite], means[finite]
    rest_names = tuple(f"{_REST}{i}" for i in range(rest.shape[1]))
    names = (*_NORMAL, *_CONSTANT_BAND, *rest_names, "opacity", *_SCALE, *_ROTATION)
    names += tuple(attributes or {})
    far = gaussians.needs_double
    if far:
        _log.warning("%s: positions far from the origin are written as float64", path)
    types = [(name, "<f8" if far else "<f4") for name in _POSITION]
    types += [(name, "<f4") for name in names]
    rows = np.empty(len(columns), types)
    for name, values in zip(_POSITION, means.numpy().T, strict=True):
        rows[name] = values
    for name, values in zip(names, columns.numpy().T, strict=True):
        rows[name] = values
    from plyfile import PlyData, PlyElement

    vertex = PlyElement.describe(rows, "vertex")
    _write(PlyData([vertex], byte_order="<", comments=[_COMMENT]), path)
    return dropped


def load_ply(path: str | Path) -> Gaussians:
    """Read Gaussians of SH degree 0 to 3 from a PLY file, text or binary.

    Properties may come in any order, and unknown ones are ignored. red, green, blue may replace the constant
    SH band. Infinite opacity logits, which some programs write for opacities of 0 and 1, become -30 and 30,
    and log-scales of minus infinity -87. Quaternions of length 0 become the identity. Gaussians that overflow
    in single precision are left out, with a warning. Opacities in [0, 1], lengths and colours in place of
    logits, logarithms and SH coefficients are converted where their values leave no doubt, with a warning,
    except in files that `save_ply` wrote. A warning says if the scene moves, or was trained with an
    anti-aliasing filter that a plain rendering lacks.

    Raises:
        PlyError: the file is missing, truncated, not a PLY, not a Gaussian scene, or has another value that
            is not finite, or only Gaussians that overflow; the message names the property and the row.
    """
    path = Path(path)
    header, vertex = _read_vertices(path)
    available = set(vertex.dtype.names or ())
    rest = _rest_names(available, path)
    painted = _has_plain_colors(available)
    required = [name for name in _REQUIRED if not (painted and name in _CONSTANT_BAND)]
    missing = [name for name in required if name not in available]
    if missing:
        raise _not_gaussians(missing, available, path)
    if _FILTER in available or any(_MIP in comment for comment in header.comments):
        _log.warning(
            "%s was trained with Mip-Splatting's filters, which a plain rendering lacks: render it with "
            "compensate_dilation, or export it again with the filters applied",
            path,
        )
    moving = available & _MOVING
    moving |= {element.name for element in header.elements if element.name.startswith(_MOTION)}
    if moving:
        _log.warning(
            "%s moves in time (%s), which is ignored: all Gaussians are shown at once",
            *(path, _listed(sorted(moving))),
        )
    logits = vertex["opacity"]
    logits[np.isinf(logits)] = np.copysign(MAX_LOGIT, logits[np.isinf(logits)])
    for name in _SCALE:
        vertex[name][np.isneginf(vertex[name])] = MIN_LOG_SCALE
    columns = {name: _column(vertex, name, path) for name in (*required, *rest)}
    if painted:
        constant = (_plain_colors(vertex, path) - 0.5) / SH_C0
        columns.update(zip(_CONSTANT_BAND, constant.unbind(1), strict=True))
    gaussians = _gaussians_from(columns, rest, path, keep=_COMMENT in header.comments)
    return without_overflow(gaussians, path)


def _not_gaussians(missing: list[str], available: set[str], path: Path) -> PlyError:
    """Return the error for vertices that lack a property; it says what they are if that is known."""
    if "packed_position" in available:
        return PlyError("the scene was compressed by SuperSplat", where=str(path), fix=CONVERT)
    if "f_anchor_feat_0" in available:
        what = "the scene stores anchors, from which networks make Gaussians (Scaffold-GS)"
        return PlyError(what, where=str(path), fix="use a scene of 3D Gaussians")
    if missing == ["scale_2"]:
        what = "the scene consists of flat 2D Gaussians (2DGS), which have two scales each"
        return PlyError(what, where=str(path), fix="use a scene of 3D Gaussians")
    return PlyError(
        f"the vertices have no {_listed(missing)}",
        where=str(path),
        fix="use a Gaussian scene, not a point cloud or a mesh",
    )


def holds_gaussians(path: str | Path) -> bool:
    """Whether the vertices of a PLY file have all properties of Gaussians (`load_ply`).

    Raises:
        PlyError: the file is missing, truncated or not a PLY.
    """
    elements = read_header(Path(path)).elements
    lines = b"".join(element.lines for element in elements if element.name == "vertex")
    found = re.findall(rb"^property[ \t]+\w+[ \t]+(\w+)", lines, flags=re.MULTILINE)
    names = {name.decode() for name in found}
    return {*_REQUIRED} <= names | ({*_CONSTANT_BAND} if _has_plain_colors(names) else set())


def load_points(path: str | Path) -> tuple[Tensor, Tensor]:
    """Read coloured points from a PLY file: a point cloud, or the centres of a Gaussian scene.

    Returns:
        Positions `[P, 3]` in the file's units and precision, and colours `[P, 3]` in [0, 1]; P may be 0.
        Colours are the constant SH band, or red, green, blue (whole numbers up to 255, or floats up to 1).

    Raises:
        PlyError: the file is missing, truncated, not a PLY, lacks positions or colours, or has a value
            that is not finite.
    """
    path = Path(path)
    _, vertex = _read_vertices(path)
    available = set(vertex.dtype.names or ())
    constant_band = set(_CONSTANT_BAND) <= available
    color_names = _CONSTANT_BAND if constant_band else _COLOR
    missing = [name for name in (*_POSITION, *color_names) if name not in available]
    if missing:
        raise PlyError(
            f"the vertices have no {_listed(missing)}",
            where=str(path),
            fix="use a point cloud with x y z and red green blue",
        )
    positions = _stacked(vertex, _POSITION, path)
    if constant_band:
        colors = _stacked(vertex, _CONSTANT_BAND, path) * SH_C0 + 0.5
        return positions, colors.clamp(0, 1)
    return positions, _plain_colors(vertex, path)


def _has_plain_colors(available: set[str]) -> bool:
    """Whether vertices have red, green, blue and no SH coefficients."""
    return {*_COLOR} <= available and available.isdisjoint(_CONSTANT_BAND)


def _plain_colors(vertex: NDArray[np.void], path: Path) -> Tensor:
    """Return red, green, blue `[P, 3]` in [0, 1]."""
    colors = _stacked(vertex, _COLOR, path)
    largest = 255 if np.issubdtype(vertex["red"].dtype, np.integer) else 1
    if colors.numel() and not 0 <= colors.min() <= colors.max() <= largest:
        raise PlyError(
            f"a colour is not in 0 to {largest}; the largest is {float(colors.max()):g}",
            where=str(path),
            fix="write colours as whole numbers up to 255, or as floats up to 1",
        )
    return colors / largest


def _read_vertices(path: Path) -> tuple[PlyHeader, NDArray[np.void]]:
    """Read the header, and the rows of the `vertex` element with a field for each property."""
    header = read_header(path)
    index = next((k for k, e in enumerate(header.elements) if e.name == "vertex"), None)
    if index is None:
        names = _listed(element.name for element in header.elements)
        raise PlyError(
            f"the PLY file has no 'vertex' element (it has: {names})",
            where=str(path),
            fix="use a point cloud, or an export of a Gaussian splatting program",
        )
    if any(element.has_lists for element in header.elements[: index + 1]):
        raise PlyError(
            "list properties in or before the vertices are not supported",
            where=str(path),
            fix="export only the points",
        )
    from plyfile import PlyData

    try:
        announced = PlyData.read(io.BytesIO(header.without_rows()))
        dtype = np.dtype(announced["vertex"].dtype(announced.byte_order))
        return header, _read_rows(path, header, index, dtype)
    except Exception as error:  # plyfile, numpy and int() raise different types
        raise PlyError(
            f"the PLY file cannot be read: {error}",
            where=str(path),
            fix="it may be damaged; copy or export it again",
        ) from error


def _read_rows(
    path: Path, header: PlyHeader, index: int, dtype: np.dtype[np.void]
) -> NDArray[np.void]:
    """Read the rows of an element; elements before it must not have lists."""
    before, count = header.elements[:index], header.elements[index].count
    with path.open("rb") as file:
        file.seek(header.body)
        if not header.text:
            file.seek(sum(e.count * e.row_bytes for e in before), os.SEEK_CUR)
            return np.fromfile(file, dtype, count)
        for _ in range(sum(e.count for e in before)):
            file.readline()
        if not count:
            return np.empty(0, dtype)
        return np.loadtxt(file, dtype, comments=None, max_rows=count, ndmin=1)


def _gaussians_from(
    columns: dict[str, Tensor], rest: list[str], path: Path, *, keep: bool
) -> Gaussians:
    def stacked(names: tuple[str, ...]) -> Tensor:
        return torch.stack([columns[name] for name in names], dim=1)

    means = stacked(_POSITION)
    log_scales, logits, constant = read_as_parameters(
        means, stacked(_SCALE), columns["opacity"], stacked(_CONSTANT_BAND), path, keep
    )
    bands = [constant[:, None, :]]  # [N, 1, 3]
    if rest:
        channel_major = stacked(tuple(rest)).reshape(constant.shape[0], 3, len(rest) // 3)
        bands.append(channel_major.transpose(1, 2))
    return Gaussians(
        means=means,
        log_scales=log_scales,
        quaternions=stacked(_ROTATION),
        opacity_logits=logits,
        sh=torch.cat(bands, dim=1),
    )


def _rest_names(available: set[str], path: Path) -> list[str]:
    """The f_rest_* properties in numerical order.

    Others, such as f_rest_01, are an error: ignoring them would lose bands of colour.
    """
    found = [name for name in available if name.startswith(_REST)]
    names = [f"{_REST}{number}" for number in range(len(found))]
    if len(found) not in _REST_COUNTS or set(found) != set(names):
        odd = max(set(found) - set(names) or found, key=lambda name: (len(name), name))
        raise PlyError(
            f"the vertices have {len(found)} f_rest properties, including {odd[:40]}",
            where=str(path),
            fix="SH degrees 0, 1, 2, 3 need 0, 9, 24, 45 of them, numbered from 0",
        )
    return names


def _stacked(vertex: NDArray[np.void], names: tuple[str, ...], path: Path) -> Tensor:
    return torch.stack([_column(vertex, name, path) for name in names], dim=1)


def _column(vertex: NDArray[np.void], name: str, path: Path) -> Tensor:
    double = name in _POSITION and vertex[name].dtype.itemsize == 8
    with np.errstate(over="ignore"):  # infinities are rejected below
        column = vertex[name].astype(np.float64 if double else np.float32)
    finite = np.isfinite(column)
    if not finite.all():
        row = int(np.argmin(finite))
        raise PlyError(
            f"{int((~finite).sum())} values of {name} are not finite, the first in vertex {row}",
            where=f"{path}: {name}[{row}]",
            fix="export the scene again without those Gaussians",
        )
    return torch.from_numpy(column)


def _write(data: PlyData, path: Path) -> None:
    temporary = path.with_name(f".{path.name}.{os.getpid()}.part")
    try:
        try:
            with temporary.open("wb") as file:
                data.write(file)
                file.flush()
                os.fsync(file.fileno())
            temporary.replace(path)
        finally:
            with suppress(FileNotFoundError):
                temporary.unlink()
    except OSError as error:
        raise PlyError(
            f"the PLY file cannot be written: {error.strerror}",
            where=str(path),
            fix="check that the folder exists, is writable and has free space",
        ) from error


def _listed(names: Iterable[str]) -> str:
    return ", ".join(names) or "nothing"
