"""Cameras from photographs alone: COLMAP's incremental structure from motion on the CPU.

SIFT with domain-size pooling (Dong and Soatto 2015), exhaustive matching, two-view geometry by RANSAC,
incremental mapping with bundle adjustment (Schoenberger and Frahm 2016). Random choices are seeded,
photographs are numbered before threads see them, and mapping runs on one thread: the result does not
depend on how threads take turns.
"""

from __future__ import annotations

import logging
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from PIL import Image

from registry.photos import Decoder, import_pycolmap, in_parallel

from .unposed_photos import UnposedPhoto

MAX_ERROR = 2.0
"""Pixels, of matches and of points; COLMAP's 4 are meant for photographs several times as large."""
_SEED = 0
_log = logging.getLogger("stereogs.photos")


@dataclass(frozen=True)
class Reconstruction:
    """What came of it.

    Args:
        models: for each connected piece, its folder (a COLMAP model) and its photographs, as indices;
            the largest first. Photographs in the model are named by their index, `0007.png`.
        matches: numbers of matches that fit one two-view geometry, by pair of indices, first < second.
        features: the number of features of each photograph.
    """

    models: list[tuple[Path, list[int]]]
    matches: dict[tuple[int, int], int]
    features: list[int]


def reconstruct(
    photos: Sequence[UnposedPhoto], decoder: Decoder, share_lens: bool, folder: Path
) -> Reconstruction:
    """Find cameras and points.

    Args:
        decoder: how photographs are read for this.
        share_lens: one lens for all photographs of one camera, size and focal length.
        folder: empty; takes the working files and the models.

    Raises:
        SceneError: a photograph is damaged.
    """
    # What it calls an error, that no model came of it, is explained here in other words.
    colmap = import_pycolmap(least_severity=3)
    images, database = folder / "images", folder / "matches.db"
    images.mkdir()
    _log.info("finding the cameras of %d photographs; this may take minutes", len(photos))
    # pycolmap is given files written here alone: a truncated photograph would end the process.
    in_parallel(
        lambda k: Image.fromarray(decoder.read(photos[k].path)).save(
            images / image_name(k), compress_level=1
        ),
        range(len(photos)),
    )
    colmap.set_random_seed(_SEED)
    colmap.Database.open(database).close()  # import_images wants it to exist
    for group in _lenses(photos, share_lens):
        _import(colmap, database, images, group, photos[group[0]], decoder)
    _extract(colmap, database, images)
    _match(colmap, database)
    with colmap.Database.open(database) as opened:
        index = {image.image_id: image_index(image.name) for image in opened.read_all_images()}
        features = {index[k]: opened.num_keypoints_for_image(k) for k in index}
        matches = _verified_matches(colmap, opened, index)
    _log.info("matched %d pairs of photographs; placing the cameras", len(matches))
    models = _map(colmap, database, images, folder)
    return Reconstruction(models, matches, [features[k] for k in range(len(photos))])


def image_name(index: int) -> str:
    """What a photograph is called inside a model."""
    return f"{index:04d}.png"


def image_index(name: str) -> int:
    """The inverse of `image_name`."""
    return int(Path(name).stem)


def _lenses(photos: Sequence[UnposedPhoto], share_lens: bool) -> list[list[int]]:
    """Indices of the photographs that each lens took."""
    groups: dict[object, list[int]] = {}
    for index, photo in enumerate(photos):
        key = (photo.size, photo.camera, photo.focal) if share_lens else index
        groups.setdefault(key, []).append(index)
    return list(groups.values())


def _import(
    colmap: Any,
    database: Path,
    images: Path,
    group: list[int],
    photo: UnposedPhoto,
    decoder: Decoder,
) -> None:
    """Number the photographs of one lens, of which `photo` is one, before threads can."""
    reader = colmap.ImageReaderOptions(camera_model="SIMPLE_RADIAL")
    if photo.focal is not None:
        width, height = decoder.size(*photo.size)
        focal = photo.focal * max(width, height)
        reader.camera_params = f"{focal},{width / 2},{height / 2},0"
    colmap.import_images(
        database,
        images,
        camera_mode=colmap.CameraMode.SINGLE,
        image_names=[image_name(k) for k in group],
        options=reader,
    )


def _extract(colmap: Any, database: Path, images: Path) -> None:
    options = colmap.FeatureExtractionOptions()
    options.sift.domain_size_pooling = True
    colmap.extract_features(database, images, extraction_options=options, device=colmap.Device.cpu)


def _match(colmap: Any, database: Path) -> None:
    geometry = colmap.TwoViewGeometryOptions()
    geometry.ransac.random_seed = _SEED
    geometry.ransac.max_error = MAX_ERROR
    colmap.match_exhaustive(
        database,
        matching_options=colmap.FeatureMatchingOptions(),
        verification_options=geometry,
        device=colmap.Device.cpu,
    )


def _verified_matches(
    colmap: Any, database: Any, index: dict[int, int]
) -> dict[tuple[int, int], int]:
    pairs, geometries = database.read_two_view_geometries()
    found = {}
    for pair, geometry in zip(pairs, geometries, strict=True):
        first, second = sorted(index[image] for image in colmap.pair_id_to_image_pair(pair))
        if len(geometry.inlier_matches):
            found[first, second] = len(geometry.inlier_matches)
    return found


def _map(colmap: Any, database: Path, images: Path, folder: Path) -> list[tuple[Path, list[int]]]:
    options = colmap.IncrementalPipelineOptions(num_threads=1, random_seed=_SEED, min_model_size=2)
    # With few photographs most points are seen by two alone, and are needed.
    options.triangulation.ignore_two_view_tracks = False
    options.mapper.filter_max_reproj_error = MAX_ERROR
    options.triangulation.merge_max_reproj_error = MAX_ERROR
    options.triangulation.complete_max_reproj_error = MAX_ERROR
    found = colmap.incremental_mapping(database, images, folder / "mapping", options)
    models = []
    for number, model in found.items():
        path = folder / f"model_{number}"
        path.mkdir()
        model.write(path)
        members = sorted(image_index(model.image(k).name) for k in model.reg_image_ids())
        models.append((path, members))
    return sorted(models, key=lambda item: -len(item[1]))
