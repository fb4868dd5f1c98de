"""The host from Python: what the verbs of the command line do, as functions, with or without files.

    import stereogs

    pipeline = stereogs.build_pipeline("pipelines/3dgs.yaml", ["scene.path=photos"])
    run = stereogs.train(pipeline, callback=lambda done: print(done.number, done.loss))
    rgb, depth, alpha = run.render(run.scene.test[0].camera)

The command line calls the same functions. Importing this package is quick; torch is imported by the first
function that computes something.
"""

from .pipelines import build_pipeline
from .runs import export, find_exporter, open_run, render, results
from .scenes import load_scene, scene_from_arrays
from .trainings import resume, train

__all__ = [
    "build_pipeline",
    "export",
    "find_exporter",
    "load_scene",
    "open_run",
    "render",
    "results",
    "resume",
    "scene_from_arrays",
    "train",
]
