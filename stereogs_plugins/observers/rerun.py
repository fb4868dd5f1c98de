"""`rerun`: cameras, photographs, points, Gaussians and curves in a file for the Rerun viewer."""

from __future__ import annotations

from typing import Any

from registry import Observer, Register, TrainingScene, hookimpl
from registry.events import IterationDone, RunEnded, RunStarted, ViewsScored
from registry.toolkit import LoggerSettings, optional_module


class RerunObserver(Observer[LoggerSettings]):
    """An .rrd file for `rerun FILE`, one per part of a resumed run; requires the extra `rerun`."""

    rerun: Any = None
    stream: Any = None

    def started(self, run: RunStarted) -> None:
        """Open a file; the viewer merges the files of a run into one recording."""
        if run.folder is None:
            return
        self.rerun = optional_module("rerun", "pip install 'stereogs-plugins[rerun]'")
        self.stream = self.rerun.RecordingStream("stereogs", recording_id=run.identity)
        self.stream.save(str(run.folder / f"after-{run.iteration:07d}.rrd"))
        self.stream.send_recording_name(run.title)
        self._log_scene(run.scene)

    def iterated(self, done: IterationDone) -> None:
        """Add a point to each curve; if a picture is due, log it and the Gaussians' centres."""
        if self.stream is None:
            return
        self._add(done.scalars(), done.iteration)
        picture = self.settings.picture(done)
        if picture is not None:
            from core_rasterizer import SH_C0

            sh = done.model.read("sh")[:, 0]
            centres = self.rerun.Points3D(
                done.model.read("means").numpy(), colors=(0.5 + SH_C0 * sh).clamp(0, 1).numpy()
            )
            self.stream.log("world/gaussians", centres)
            self.stream.log(f"views/{done.view.name}", self.rerun.Image(picture))

    def evaluated(self, scored: ViewsScored) -> None:
        """Add the scores."""
        if self.stream is not None:
            self._add(scored.scalars(), scored.iteration)

    def ended(self, run: RunEnded) -> None:
        """Close the file; log the error of a failed run."""
        if self.stream is None:
            return
        if run.error is not None:
            self.stream.log("error", self.rerun.TextLog(run.error, level="ERROR"))
        self.stream.flush()
        self.stream.disconnect()

    def _log_scene(self, scene: TrainingScene) -> None:
        """Log the training cameras, their photographs and the scene's points, which are static."""
        rerun, log = self.rerun, self.stream.log
        log("world", rerun.ViewCoordinates.RIGHT_HAND_Y_DOWN, static=True)
        for view in scene.train:
            camera, path = view.camera, f"world/cameras/{view.name}"
            pose = camera.camera_to_world.detach().numpy()
            log(path, rerun.Transform3D(translation=pose[:3, 3], mat3x3=pose[:3, :3]), static=True)
            pinhole = rerun.Pinhole(
                image_from_camera=camera.intrinsics.numpy(),
                resolution=(camera.width, camera.height),
                camera_xyz=rerun.ViewCoordinates.RDF,
            )
            log(path, pinhole, static=True)
            log(path, rerun.Image((view.image * 255).round().byte().numpy()), static=True)
        if scene.points is not None:
            points = scene.points
            cloud = rerun.Points3D(points.positions.numpy(), colors=points.colors.numpy())
            log("world/points", cloud, static=True)

    def _add(self, scalars: dict[str, float], iteration: int) -> None:
        self.stream.set_time("iteration", sequence=iteration)
        for name, value in scalars.items():
            self.stream.log(f"curves/{name}", self.rerun.Scalars(value))


@hookimpl
def stereogs_register_observers(register: Register[RerunObserver]) -> None:
    register("rerun", RerunObserver)
