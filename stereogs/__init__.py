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
    from core_rasterizer import (
        Camera as Camera,
        ExplainedError as ExplainedError,
        list_devices as list_devices,
        open_device as open_device,
    )
    from registry import PointCloud as PointCloud, Scene as Scene, View as View
    from registry.pipeline.pipeline import Pipeline as Pipeline
    from registry.runs.evaluation import Picture as Picture
    from registry.runs.options import RunOptions as RunOptions
    from registry.runs.run import Run as Run
    from registry.training.trainer import Iteration as Iteration

    from .quality import within as within
    from .session import (
        build_pipeline as build_pipeline,
        load_scene as load_scene,
        open_run as open_run,
        render as render,
        results as results,
        resume as resume,
        scene_from_arrays as scene_from_arrays,
        train as train,
    )
    from .verbs.export import export as export
    from .verbs.next_views import NextView as NextView, next_views as next_views
else:
    __all__, __dir__, __getattr__ = names_on_first_use(__name__)
