"""Which files are changed, and which tests must notice."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field
from pathlib import Path

ROOT = Path(__file__).parents[2]
_ENGINE = "tests/core_rasterizer/test_"


@dataclass(frozen=True)
class Area:
    """A part of the code.

    Args:
        patterns: of its files. A file without a test of its own (`tests/<folder>/test_<name>.py`) or an entry
            in `tests` is left out.
        tests: names of test files below `tests/` by file, instead of the file's own test.
        options: of pytest.
        engine: whether the names in `tests` are of `tests/core_rasterizer`.
    """

    patterns: tuple[str, ...]
    tests: Mapping[str, str] = field(default_factory=dict)
    options: tuple[str, ...] = ()

    def files(self) -> Iterator[tuple[str, tuple[str, ...]]]:
        """Yield each file and its tests, sorted."""
        found = {path for pattern in self.patterns for path in ROOT.glob(pattern)}
        for path in sorted(found):
            file = path.relative_to(ROOT)
            own = Path("tests") / file.parent / f"test_{file.name}"
            if listed := self.tests.get(str(file)):
                yield str(file), tuple(listed.split())
            elif file.suffix == ".py" and (ROOT / own).is_file():
                yield str(file), (str(own),)


def _engine(folder: str, **tests: str) -> dict[str, str]:
    return {
        f"core_rasterizer/{folder}/kernels/{name}.cl": " ".join(
            f"{_ENGINE}{test}.py" for test in listed.split()
        )
        for name, listed in tests.items()
    }


_CPU = {
    **_engine(
        "raster",
        backward_step="step_without_gradients",
        bin="tile_lists rasterize",
        blend="rasterize",
        cover="tile_lists rasterize",
        harmonics="rasterize",
        lists_of_few="tile_lists rasterize",
        pose="gradcheck",
        project="rasterize visible",
        project_backward="rasterize gradcheck absolute_gradient",
        projection="rasterize gradcheck",
        raster_cpu="rasterize absolute_gradient visible",
        scan="tile_lists rasterize",
        sort="tile_lists rasterize",
    ),
    **_engine(
        "optimization",
        adam="optimizer",
        adam_values="optimizer poison",
        photometric="photometric",
        ssim="photometric",
        topology="topology relocation",
    ),
    **_engine(
        "matching",
        feature_sweep="plane_sweep",
        patch_costs="patch_match",
        patch_match="patch_match",
        patch_plane="patch_match",
        patch_window="patch_match",
        pixel_pairs="plane_sweep",
        plane_sweep="plane_sweep",
        rectified="matching_rectified",
        semi_global="matching_semi_global",
        sweep_images="plane_sweep",
    ),
}
_GPU = {
    **_engine(
        "raster",
        blend="rasterize",
        group_scan="tile_lists rasterize",
        pairs_gpu="tile_lists rasterize",
        raster_gpu="rasterize absolute_gradient visible",
        sort_gpu="tile_lists rasterize",
    ),
    **_engine("optimization", photometric_gpu="photometric"),
}
_TRAINING = " ".join(
    f"tests/registry/training/test_{n}.py" for n in ("trainer", "extension_points")
)
_HOST = {
    "registry/contract/checks/answers.py": "tests/registry/contract/checks/test_answers.py "
    "tests/registry/training/test_weights.py",
    "registry/pipeline/parts.py": _TRAINING,
    "registry/training/field.py": _TRAINING,
    "registry/training/trainer.py": _TRAINING,
    "registry/runs/origin.py": "tests/registry/runs/test_inputs.py "
    "tests/registry/runs/test_source_code.py",
    "registry/runs/results.py": "tests/registry/runs/test_results.py "
    "tests/registry/runs/test_training_run.py",
}
_PHOTOS = "tests/stereogs_plugins/scenes/photos/"
_LOADERS = {
    "registry/toolkit/photos/decoder.py": "tests/registry/toolkit/photos/test_decoder.py "
    "tests/stereogs_plugins/scenes/test_nerfstudio.py",
    "stereogs_plugins/scenes/photos/photogrammetry/matching.py": _PHOTOS
    + "photogrammetry/test_matching.py "
    f"{_PHOTOS}test_loader.py",
}
AREAS = {
    "plugins": Area(("stereogs_plugins/[!s]*/**/*.py", "stereogs_plugins/samplers/*.py")),
    "loaders": Area(("stereogs_plugins/scenes/**/*.py", "registry/toolkit/photos/*.py"), _LOADERS),
    "host": Area(
        ("registry/[!t]*/**/*.py", "registry/training/*.py", "registry/toolkit/[!p]*/**/*.py"),
        _HOST,
    ),
    "kernels, CPU variant": Area(tuple(_CPU), _CPU, ("-k", "not gpu_kernels")),
    "kernels, GPU variant": Area(tuple(_GPU), _GPU, ("-k", "not cpu_kernels")),
}
