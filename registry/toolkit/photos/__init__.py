"""Building blocks of scene loaders: from untrusted files to a validated `Scene`.

    from registry.toolkit import photos

    photos.read_document(path, Model, fix)      JSON with explained errors
    photos.read_arrays(path, names, fix)        .npz and .npy, limited to the size of the file
    photos.Decoder(photos.at_most(800))         images: decode, resize, composite on a background
    photos.Lens(...), photos.pose_from_opengl   cameras: lenses with distortion, poses
    photos.SplitSettings, photos.estimate_bounds values that the files do not contain
    photos.read_colmap_model(folder, fix)       COLMAP models: cameras, poses, points and tracks
    photos.PosedPhoto, photos.LoadedPhotos      the steps to a `Scene` that all built-in loaders use

docs/plugin_reference.md builds a whole loader with it.
"""

from typing import TYPE_CHECKING

from core_rasterizer.first_use import names_on_first_use

if TYPE_CHECKING:
    from ..progress.parallel import in_parallel
    from .bounds import Bounds, estimate_bounds
    from .colmap_files import ColmapImage, has_colmap_model
    from .colmap_model import POINTS_FIX, ColmapModel, Tracks, read_colmap_model
    from .decoder import (
        BACKGROUNDS,
        HEIF_SUFFIXES,
        Decoder,
        Pixels,
        ResizeFilter,
        Size,
        at_most,
        dark_background,
        divided_by,
        longest_side,
        open_8_bit,
        open_image,
        read_heif,
        read_mask,
        stored_size,
        upright_size,
    )
    from .lens import Distortion, Lens, import_pycolmap, pose_from_axes, pose_from_opengl, undistort
    from .loaded_photos import LoadedPhotos, PosedPhoto
    from .reading import (
        IMAGE_SUFFIXES,
        Finite,
        Matrix4x4,
        MatrixRow,
        decoding,
        find_image,
        inside,
        list_images,
        read_array,
        read_arrays,
        read_document,
        view_names,
    )
    from .source_settings import (
        ImageSourceSettings,
        SplitSettings,
        evenly_spaced,
    )
else:
    __getattr__, __dir__ = names_on_first_use(__name__)

__all__ = [
    "BACKGROUNDS",
    "HEIF_SUFFIXES",
    "IMAGE_SUFFIXES",
    "POINTS_FIX",
    "Bounds",
    "ColmapImage",
    "ColmapModel",
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
    "longest_side",
    "open_8_bit",
    "open_image",
    "pose_from_axes",
    "pose_from_opengl",
    "read_array",
    "read_arrays",
    "read_colmap_model",
    "read_document",
    "read_heif",
    "read_mask",
    "stored_size",
    "undistort",
    "upright_size",
    "view_names",
]
