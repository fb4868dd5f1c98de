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
    from .bounds import (
        Bounds as Bounds,
        estimate_bounds as estimate_bounds,
        object_bounds as object_bounds,
    )
    from .colmap_files import (
        colmap_models as colmap_models,
        count_images as count_images,
        has_colmap_model as has_colmap_model,
    )
    from .colmap_model import (
        POINTS_FIX as POINTS_FIX,
        ColmapModel as ColmapModel,
        Tracks as Tracks,
        read_colmap_model as read_colmap_model,
    )
    from .copies import Impression as Impression
    from .decoder import (
        BACKGROUNDS as BACKGROUNDS,
        HEIF_SUFFIXES as HEIF_SUFFIXES,
        Decoder as Decoder,
        ResizeFilter as ResizeFilter,
        Size as Size,
        at_most as at_most,
        divided_by as divided_by,
        longest_side as longest_side,
        open_8_bit as open_8_bit,
        read_heif as read_heif,
        stored_form as stored_form,
        stored_size as stored_size,
        upright_size as upright_size,
    )
    from .lens import (
        Distortion as Distortion,
        Lens as Lens,
        import_pycolmap as import_pycolmap,
        pose_from_axes as pose_from_axes,
        pose_from_opengl as pose_from_opengl,
        undistort as undistort,
    )
    from .loaded_photos import (
        LoadedPhotos as LoadedPhotos,
        PosedPhoto as PosedPhoto,
        usable_photos as usable_photos,
    )
    from .masks.files import (
        are_masks as are_masks,
        find_masks as find_masks,
        masks_beside as masks_beside,
    )
    from .masks.reading import read_mask as read_mask
    from .reading import (
        IMAGE_SUFFIXES as IMAGE_SUFFIXES,
        Finite as Finite,
        MatrixRow as MatrixRow,
        PoseMatrix as PoseMatrix,
        decoding as decoding,
        find_image as find_image,
        inside as inside,
        list_images as list_images,
        read_array as read_array,
        read_arrays as read_arrays,
        read_document as read_document,
        view_names as view_names,
    )
    from .source_settings import (
        ImageSourceSettings as ImageSourceSettings,
        SplitSettings as SplitSettings,
        evenly_spaced as evenly_spaced,
    )
else:
    __all__, __dir__, __getattr__ = names_on_first_use(__name__)
