"""COLMAP with types: the only module here that imports pycolmap.

A model is pycolmap's `Reconstruction` of photographs named by index (`image_name`); all have the camera model
SIMPLE_RADIAL: focal length, principal point, k1. Random choices are seeded and mapping uses one thread, so
that results are the same bits.
"""

from __future__ import annotations

from pathlib import PurePath
from typing import TYPE_CHECKING, Any, NamedTuple, cast

import numpy as np

from registry.toolkit.photos import import_pycolmap

from . import thresholds

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator, Mapping, Sequence
    from pathlib import Path

    import pycolmap
    from numpy.typing import NDArray
    from pycolmap import Camera, Database, Image, Reconstruction as Model, TwoViewGeometry

    Array = NDArray[np.float64]
else:

    class _OnFirstUse:
        """pycolmap takes long to import; it logs missing models as errors, which disconnected.py explains."""

        def __getattr__(self, name: str) -> Any:
            value = self.__dict__[name] = getattr(import_pycolmap(least_severity=3), name)
            return value

    pycolmap = _OnFirstUse()

__all__ = ["Array", "Camera", "Database", "Image", "Model", "TwoViewGeometry"]
SEED = 0
_MAX_ITERATIONS, _TOLERANCE = 100, 1e-8


def image_name(index: int) -> str:
    """Name of a photograph in a COLMAP model."""
    return f"{index:04d}.png"


def image_index(name: str) -> int:
    """Inverse of `image_name`."""
    return int(PurePath(name).stem)


def mask_of(image: Path) -> Path:
    """Path of the mask of a photograph, where COLMAP looks for it; it may be missing."""
    return image.parent.with_name("masks") / f"{image.name}.png"


# Databases of keypoints and matches


def open_database(path: Path) -> Database:
    """Open a database, a context manager; creates it if it is missing."""
    return pycolmap.Database.open(path)


def create_database(path: Path) -> None:
    """Create an empty database, and start the sequence of random numbers."""
    pycolmap.set_random_seed(SEED)
    open_database(path).close()


def add_photos(
    database: Path, images: Path, indices: Sequence[int], lens: tuple[float, int, int] | None
) -> None:
    """Add the photographs of one lens in a fixed order to an existing database.

    Args:
        images: folder of the photographs, named by index.
        lens: focal length, width and height in pixels if they are known.
    """
    reader = pycolmap.ImageReaderOptions(camera_model="SIMPLE_RADIAL")
    if lens is not None:
        focal, width, height = lens
        reader.camera_params = f"{focal},{width / 2},{height / 2},0"
    pycolmap.import_images(
        database,
        images,
        camera_mode=pycolmap.CameraMode.SINGLE,
        image_names=[image_name(k) for k in indices],
        options=reader,
    )


def extract_sift(database: Path, images: Path, pooled: bool) -> None:
    """Add keypoints by SIFT (Lowe 2004) on the CPU, none where a photograph's mask (`mask_of`) is black.

    Args:
        pooled: use domain-size pooling (Dong and Soatto 2015), which tolerates wider baselines.
    """
    options = pycolmap.FeatureExtractionOptions()
    options.sift.domain_size_pooling = pooled
    reader = pycolmap.ImageReaderOptions()
    masks = mask_of(images / image_name(0)).parent
    if masks.is_dir():
        reader.mask_path = masks
    pycolmap.extract_features(
        *(database, images),
        reader_options=reader,
        extraction_options=options,
        device=pycolmap.Device.cpu,
    )


def match_exhaustively(database: Path) -> None:
    """Add the matches of all pairs, verified by two-view geometry."""
    pycolmap.match_exhaustive(
        database, verification_options=_two_view_options(), device=pycolmap.Device.cpu
    )


def verify_matches(database: Path) -> None:
    """Add the two-view geometry of pairs with matches."""
    pycolmap.geometric_verification(database, two_view_geometry_options=_two_view_options())


def _two_view_options() -> pycolmap.TwoViewGeometryOptions:
    options = pycolmap.TwoViewGeometryOptions()
    options.ransac.random_seed = SEED
    options.ransac.max_error = thresholds.MAX_ERROR
    return options


class VerifiedPair(NamedTuple):
    """Two photographs, by image id, and their two-view geometry with one verified match or more."""

    images: tuple[int, int]
    geometry: TwoViewGeometry

    @property
    def matches(self) -> NDArray[np.uint32]:
        """Rows `[M, 2]` of the keypoints of the verified matches."""
        return np.asarray(self.geometry.inlier_matches)

    @property
    def homography(self) -> Array | None:
        """`[3, 3]` of pixels of the first photograph to those of the second."""
        return None if self.geometry.H is None else np.asarray(self.geometry.H)

    @property
    def has_depth(self) -> bool:
        """False if a homography explains the matches."""
        kinds = pycolmap.TwoViewGeometryConfiguration
        flat = kinds.PLANAR, kinds.PANORAMIC, kinds.PLANAR_OR_PANORAMIC
        return self.geometry.config not in flat


def verified_pairs(database: Database) -> Iterator[VerifiedPair]:
    """Yield the pairs with verified matches."""
    for key, geometry in zip(*database.read_two_view_geometries(), strict=True):
        if len(geometry.inlier_matches):
            yield VerifiedPair(pycolmap.pair_id_to_image_pair(key), geometry)


def matched_points(
    database: Database, images: tuple[int, int], matches: NDArray[np.uint32]
) -> tuple[Array, Array]:
    """Positions `[M, 2]` in pixels of matches `[M, 2]`, in the first and in the second photograph."""
    first, second = (
        database.read_keypoints(image)[:, :2][matches[:, side]] for side, image in enumerate(images)
    )
    return first.astype(np.float64), second.astype(np.float64)


# Models


def read_model(folder: Path) -> Model:
    """Read a model from a folder."""
    return pycolmap.Reconstruction(folder)


def copy_of(model: Model) -> Model:
    """Return a copy that shares nothing with the model."""
    return pycolmap.Reconstruction(model)


def index_of(model: Model, image: int) -> int:
    """Index of the photograph of an image id."""
    return image_index(model.image(image).name)


def lens_of(model: Model, image: int) -> Camera:
    """Lens of an image id."""
    return model.camera(model.image(image).camera_id)


def relative_focal(lens: Camera) -> float:
    """Focal length in units of the longer side."""
    return lens.focal_length / max(lens.width, lens.height)


def set_focal(lens: Camera, focal: float) -> None:
    """Change the focal length, in pixels."""
    lens.params = [focal, *lens.params[1:]]


def rays_of(lens: Camera, pixels: Array) -> Array:
    """Directions `[N, 3]` with z = 1, without distortion, of positions `[N, 2]` in pixels."""
    return np.column_stack([cast("Array", lens.cam_from_img(pixels)), np.ones(len(pixels))])


def pixels_of(lens: Camera, rays: Array) -> Array:
    """Inverse of `rays_of`."""
    return cast("Array", lens.img_from_cam(rays))


def map_incrementally(
    database: Path,
    images: Path,
    folder: Path,
    *,
    degrees: float,
    fixed_lens: bool,
    on_image: Callable[[], None],
) -> list[Model]:
    """Incremental mapping (Schoenberger and Frahm 2016).

    Args:
        images: folder of the photographs, for the colours of points.
        folder: folder for the models.
        degrees: least triangulation angle of the first pair.
        fixed_lens: keep the initial lens.
        on_image: called when a photograph was placed.
    """
    options = pycolmap.IncrementalPipelineOptions(num_threads=1, random_seed=SEED, min_model_size=2)
    options.mapper.init_min_tri_angle = degrees
    # With few photographs most points are seen by only two.
    options.triangulation.ignore_two_view_tracks = False
    options.mapper.filter_max_reproj_error = thresholds.MAX_ERROR
    options.triangulation.merge_max_reproj_error = thresholds.MAX_ERROR
    options.triangulation.complete_max_reproj_error = thresholds.MAX_ERROR
    options.ba_refine_focal_length = options.ba_refine_extra_params = not fixed_lens
    found = pycolmap.incremental_mapping(
        database, images, folder, options, next_image_callback=on_image
    )
    return list(found.values())


def map_globally(database: Path, images: Path, folder: Path) -> list[Model]:
    """Global mapping (Pan et al. 2024), which needs no first pair; arguments as above."""
    options = pycolmap.GlobalPipelineOptions(num_threads=1, random_seed=SEED)
    options.mapper.num_threads = 1
    options.mapper.retriangulation.ignore_two_view_tracks = False
    return list(pycolmap.global_mapping(database, images, folder, options).values())


def model_from_cameras(database: Path, poses: Sequence[Array], focals: Sequence[float]) -> Model:
    """Return a model of a database's photographs without points.

    Args:
        poses: world-to-camera `[3, 4]` of each photograph, by index.
        focals: in pixels, by index; a lens has the median of its photographs', or its focal length by EXIF.
    """
    model = pycolmap.Reconstruction()
    with open_database(database) as opened:
        photos = sorted(opened.read_all_images(), key=lambda image: image.image_id)
        for lens in opened.read_all_cameras():
            if not lens.has_prior_focal_length:
                own = [p.name for p in photos if p.camera_id == lens.camera_id]
                set_focal(lens, float(np.median([focals[image_index(name)] for name in own])))
            model.add_camera_with_trivial_rig(lens)
    for photo in photos:
        pose = poses[image_index(photo.name)]
        image = pycolmap.Image(name=photo.name, camera_id=photo.camera_id, image_id=photo.image_id)
        model.add_image_with_trivial_frame(image, pycolmap.Rigid3d(pose))
    return model


def triangulated(
    model: Model, database: Path, images: Path, folder: Path, *, degrees: float, pixels: float
) -> Model:
    """Return a model with these cameras, and new points of the verified matches that agree with them.

    Args:
        images: folder of the photographs, for the colours of points.
        folder: folder for files that COLMAP writes.
        degrees, pixels: largest error of the rays and of the positions of a match.
    """
    options = pycolmap.IncrementalPipelineOptions(num_threads=1, random_seed=SEED)
    options.triangulation.ignore_two_view_tracks = False
    options.triangulation.create_max_angle_error = degrees
    options.triangulation.continue_max_angle_error = degrees
    options.triangulation.merge_max_reproj_error = pixels
    options.triangulation.complete_max_reproj_error = pixels
    options.mapper.filter_max_reproj_error = pixels
    return pycolmap.triangulate_points(model, database, images, folder, options=options)


def scale(model: Model, factor: float) -> Model:
    """Multiply a model's positions by a factor, in place; return it."""
    model.transform(pycolmap.Sim3d(factor, pycolmap.Rotation3d(), np.zeros(3)))
    return model


# Bundle adjustment


def with_id(lens: Camera, number: int) -> Camera:
    """Return a copy of a lens with another id."""
    return pycolmap.Camera(lens.todict() | {"camera_id": number})


class Track(NamedTuple):
    """A point `[3]`, and where photographs show it: image ids and positions `[2]` in pixels."""

    point: Array
    seen: Sequence[tuple[int, Array]]


def assemble(model: Model, lenses: Mapping[int, Camera], tracks: Sequence[Track]) -> Model:
    """Return a new model with the poses of another one, and these lenses by image id and points."""
    new = pycolmap.Reconstruction()
    for lens in {lens.camera_id: lens for lens in lenses.values()}.values():
        new.add_camera_with_trivial_rig(lens)
    keypoints: dict[int, list[Array]] = {k: [] for k in model.reg_image_ids()}
    elements = []
    for track in tracks:
        elements.append([pycolmap.TrackElement(k, len(keypoints[k])) for k, _ in track.seen])
        for k, place in track.seen:
            keypoints[k].append(place)
    for k, places in keypoints.items():
        image = pycolmap.Image(
            name=model.image(k).name,
            keypoints=np.array(places),
            camera_id=lenses[k].camera_id,
            image_id=k,
        )
        new.add_image_with_trivial_frame(image, model.image(k).cam_from_world())
    for track, seen in zip(tracks, elements, strict=True):
        new.add_point3D(track.point, pycolmap.Track(elements=seen))
    return new


def bundle_adjust(model: Model, fixed_focal: bool, centre_of: int | None) -> None:
    """Minimize the soft L1 loss of a model's reprojection errors.

    Args:
        fixed_focal: keep the focal lengths.
        centre_of: lens by id whose principal point is free too, while the other lenses are fixed.
    """
    # All free: COLMAP's own choice may fix three points, which has two constraints too many.
    config = pycolmap.BundleAdjustmentConfig()
    for k in model.reg_image_ids():
        config.add_image(k)
    options = pycolmap.BundleAdjustmentOptions(print_summary=False)
    options.refine_focal_length = not fixed_focal
    if centre_of is not None:
        options.refine_principal_point = True
        for lens in set(model.cameras).difference([centre_of]):
            config.set_constant_cam_intrinsics(lens)
    options.ceres.loss_function_type = pycolmap.LossFunctionType.SOFT_L1
    options.ceres.loss_function_scale = thresholds.LOSS_SCALE
    solver = options.ceres.solver_options
    solver.num_threads, solver.max_num_iterations = 1, _MAX_ITERATIONS
    solver.function_tolerance = _TOLERANCE
    pycolmap.create_default_bundle_adjuster(options, config, model).solve()
    model.update_point_3d_errors()
