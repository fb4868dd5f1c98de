"""What a training starts from: the loaded scene, then the first points and Gaussians."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass, replace
from time import monotonic

from core_rasterizer import Device, Engine, Gaussians

from ..calls.blame import blame
from ..calls.policy import checked_plugins, initialization
from ..calls.process_state import one_torch_thread
from ..calls.read_only_guard import of_scene
from ..calls.watchdog import WATCHDOG
from ..contract.checks.scene import validate
from ..contract.scene import PointCloud, Scene
from ..pipeline.faults import faults, refuse_unmet_needs
from ..pipeline.parts import Parts, load_scene
from ..pipeline.pipeline import Pipeline
from ..toolkit.progress.display import showing
from ..toolkit.progress.stages import STAGES, progress
from ..training.initial_model import initial_gaussians
from ..training.prior_masks import with_prior_masks
from ..training.scene_facts import summary, warnings
from .options import RunOptions, find_device


@contextmanager
def running(options: RunOptions) -> Iterator[RunOptions]:
    """One torch thread, progress on a console, and the checks of plugins that the options select.

    Yields the options, with the console, for all functions that are called within the block.
    """
    console = options.console()
    with (
        one_torch_thread(),
        showing(console),
        checked_plugins(options.check_plugins),
        WATCHDOG.ending(options.hang_after),
    ):
        yield replace(options, progress=console)


@dataclass(frozen=True, eq=False)
class Loaded:
    """The components of a pipeline and the scene that they loaded.

    Args:
        parts: all constructed.
        scene: the training and test views.
        seconds: wall-clock time of loading.
    """

    parts: Parts
    scene: Scene
    seconds: float

    def again(self, pipeline: Pipeline) -> Loaded:
        """Load the scene with the loader of another pipeline."""
        begin, parts = monotonic(), self.parts.following(pipeline)
        scene = load_scene(parts.one("scene"))
        return Loaded(parts, scene, self.seconds + monotonic() - begin)


@dataclass(frozen=True, eq=False)
class Prepared:
    """State of a run before its first iteration.

    Args:
        parts: components of the pipeline.
        scene: the training and test views, in the file's coordinates.
        framed: the same in the frame of training.
        points: output of the initializer.
        gaussians: initial Gaussians, created from the points.
        loading, initialization: wall-clock seconds of the scene and of the points.
    """

    parts: Parts
    scene: Scene
    framed: Scene
    points: PointCloud
    gaussians: Gaussians
    loading: float
    initialization: float

    @property
    def pipeline(self) -> Pipeline:
        """The pipeline that the parts were built from."""
        return self.parts.pipeline

    def of(self, pipeline: Pipeline) -> Prepared:
        """Return the state that a pipeline with the same scene, priors and initializer starts from.

        Raises:
            PluginError: a component needs a prior or an output that the pipeline does not have.
        """
        refuse_unmet_needs(pipeline, absolute_gradients=_absolute(self.parts.device))
        parts = self.parts.following(pipeline)
        gaussians = initial_gaussians(self.points, pipeline.training)
        return replace(self, parts=parts, gaussians=gaussians)


def load(pipeline: Pipeline, options: RunOptions) -> Loaded:
    """Construct the components and load the scene, unless the options give one."""
    device = find_device(options.device)
    refuse_unmet_needs(pipeline, absolute_gradients=_absolute(device))
    parts, begin = Parts(pipeline, device), monotonic()
    list(parts)  # constructs every component: find mistakes before the scene is loaded
    scene = load_scene(parts.one("scene")) if options.scene is None else validate(options.scene)
    return Loaded(parts, scene, monotonic() - begin)


def _absolute(device: Device | Engine) -> bool:
    """Whether the engine collects absolute screen gradients; a device stands for its OpenCL engine."""
    return isinstance(device, Device) or device.absolute_gradients


def prepare(loaded: Loaded, options: RunOptions) -> Prepared:
    """Describe the scene on the console, and create the first points and Gaussians."""
    scene, console, begin = loaded.scene, options.console(), monotonic()
    pipeline = loaded.parts.pipeline.for_views(len(scene.train))
    parts = loaded.parts.following(pipeline)
    STAGES.begin(None)
    console.print(summary(scene))
    fallbacks = [
        f"fallback: the prior {i.fallback}; see `stereogs models`"
        for i in pipeline.items["priors"]
        if i.fallback
    ]
    for warning in [*warnings(scene), *fallbacks, *faults(pipeline)]:
        console.print(f"warning: {warning}")
    framed = with_prior_masks(scene.in_frame(), parts)
    initializer, known = parts.one("initializer"), framed.for_training()
    progress("depth" if initializer.component.needs_priors else "points")
    points = initializer.call(known, parts.priors, checks=initialization(), guard=of_scene(known))
    with blame(initializer.item):
        gaussians = initial_gaussians(points, pipeline.training)
    return Prepared(parts, scene, framed, points, gaussians, loaded.seconds, monotonic() - begin)
