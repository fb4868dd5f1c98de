"""Python API for sparse-view 3D Gaussian splatting, equivalent to the command line.

    import stereogs

    scene = stereogs.load_scene("photos")
    run = stereogs.train("pipelines/3dgs.yaml", scene=scene)
    print(run.scores["test"].mean)

See docs/python.md. Importing it is fast: torch is imported on first use.
"""

from typing import TYPE_CHECKING

from core_rasterizer.first_use import names_on_first_use

if TYPE_CHECKING:
    from core_rasterizer import Camera, ExplainedError, list_devices, open_device
    from registry import PointCloud, Scene, View
    from registry.pipeline.pipeline import Pipeline
    from registry.runs.evaluation import Picture
    from registry.runs.options import RunOptions
    from registry.runs.run import Run
    from registry.training.trainer import Iteration

    from .quality import within
    from .session import (
        build_pipeline,
        load_scene,
        open_run,
        render,
        results,
        resume,
        scene_from_arrays,
        train,
    )
    from .verbs.export import export
    from .verbs.next_views import NextView, next_views
else:
    __getattr__, __dir__ = names_on_first_use(__name__)

__all__ = [
    "Camera",
    "ExplainedError",
    "Iteration",
    "NextView",
    "Picture",
    "Pipeline",
    "PointCloud",
    "Run",
    "RunOptions",
    "Scene",
    "View",
    "build_pipeline",
    "export",
    "list_devices",
    "load_scene",
    "next_views",
    "open_device",
    "open_run",
    "render",
    "results",
    "resume",
    "scene_from_arrays",
    "train",
    "within",
]
