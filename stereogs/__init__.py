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
    from registry.pipeline import Pipeline
    from registry.runs import Run, RunOptions
    from registry.runs.evaluation import Picture
    from registry.session import (
        build_pipeline,
        load_scene,
        open_run,
        render,
        results,
        resume,
        scene_from_arrays,
        train,
    )
    from registry.training import Iteration
    from stereogs_plugins.tools.export import export
    from stereogs_plugins.tools.next_views import NextView, next_views
    from stereogs_plugins.tools.quality import within
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
