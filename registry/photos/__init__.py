"""What scene loaders are made of: from files that nobody vouches for to a checked `Scene`.

    from registry import photos

    photos.read_document(path, Model, fix)      files: explained errors instead of tracebacks
    photos.read_arrays(path, names, fix)        numpy's .npz and .npy: never more than the file can hold
    photos.Decoder(photos.at_most(800))         pictures: decoded, resized, laid on a background
    photos.Lens(...), photos.pose_from_opengl   cameras: lenses with distortion, poses
    photos.split(...), photos.estimate_bounds   what the files do not say
    photos.read_colmap_model(folder, fix)       COLMAP's models: cameras, poses, points and tracks
    photos.PosedPhoto, photos.LoadedPhotos      the way to a `Scene` that every built-in loader takes

docs/examples/stereogs-turntable-scene is a complete loader.
"""

from typing import TYPE_CHECKING

from core_rasterizer.first_use import names_on_first_use

if TYPE_CHECKING:
    from ..system.parallel import in_parallel
    from .arrays import read_array, read_arrays
    from .cameras.bounds import Bounds, estimate_bounds
    from .cameras.colmap_files import ColmapCamera, ColmapImage, ColmapPoint
    from .cameras.colmap_model import ColmapModel, has_colmap_model, read_colmap_model
    from .cameras.lens import Distortion, Lens
    from .cameras.poses import pose_from_axes, pose_from_opengl
    from .cameras.safe_pycolmap import import_pycolmap
    from .cameras.tracks import POINTS_FIX, Tracks
    from .cameras.undistortion import undistort
    from .images.dark_pixels import dark_background
    from .images.decoder import (
        BACKGROUNDS,
        Decoder,
        Pixels,
        ResizeFilter,
        read_mask,
        stored_size,
        upright_size,
    )
    from .images.heif import HEIF_SUFFIXES, read_heif
    from .images.image_files import IMAGE_SUFFIXES, find_image, list_images
    from .images.image_source import ImageSourceSettings
    from .images.opening import open_image
    from .images.sizes import Size, SizeRule, at_most, divided_by, longest_side
    from .loaded_photos import LoadedPhotos
    from .posed_photos import PosedPhoto, load_views
    from .reading import Finite, Matrix4x4, MatrixRow, decoding, inside, read_document, view_names
    from .splits import SplitSettings, evenly_spaced, split, split_rule
else:
    __getattr__, __dir__ = names_on_first_use(__name__)

__all__ = [
    "BACKGROUNDS",
    "HEIF_SUFFIXES",
    "IMAGE_SUFFIXES",
    "POINTS_FIX",
    "Bounds",
    "ColmapCamera",
    "ColmapImage",
    "ColmapModel",
    "ColmapPoint",
    "Decoder",
    "Distortion",
    "Finite",
    "ImageSourceSettings",
    "Lens",
    "LoadedPhotos",
    "Matrix4x4",
    "MatrixRow",
    "Pixels",
    "PosedPhoto",
    "ResizeFilter",
    "Size",
    "SizeRule",
    "SplitSettings",
    "Tracks",
    "at_most",
    "dark_background",
    "decoding",
    "divided_by",
    "estimate_bounds",
    "evenly_spaced",
    "find_image",
    "has_colmap_model",
    "import_pycolmap",
    "in_parallel",
    "inside",
    "list_images",
    "load_views",
    "longest_side",
    "open_image",
    "pose_from_axes",
    "pose_from_opengl",
    "read_array",
    "read_arrays",
    "read_colmap_model",
    "read_document",
    "read_heif",
    "read_mask",
    "split",
    "split_rule",
    "stored_size",
    "undistort",
    "upright_size",
    "view_names",
]
