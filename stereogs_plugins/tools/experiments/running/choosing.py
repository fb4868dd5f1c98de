"""Who trains the runs: processes of this machine, or a runner of a plugin."""

from __future__ import annotations

from importlib.metadata import version

from core_rasterizer import Device
from registry.contract import HOOK_POINTS, HookPoint
from registry.errors import PipelineError
from registry.pipeline import Node, Part, Place, build_part, component_item, expand
from registry.plugins import Offer, Plugins

from .local_processes import LocalProcesses

LOCAL = "local"
"""What the host's own runner is called."""
RUNNER = next(point for point in HOOK_POINTS if point.section == "runner")


def choose_runner(written: Node | None, jobs: int | None, plugins: Plugins, device: Device) -> Part:
    """The runner that is written, or `local`.

    Args:
        written: as a pipeline writes a component.
        jobs: in place of the setting of `local`.

    Raises:
        PipelineError: settings that it refuses; `jobs` for another one than `local`.
        PluginError: no plugin offers it, or it cannot be loaded or built.
    """

    def find(point: HookPoint, name: str) -> Offer:
        if name != LOCAL:
            return plugins.find(point, name)
        package = "stereogs-plugins"
        return Offer(point, LOCAL, LocalProcesses, "registry", package, version(package))

    if jobs is not None:
        place = Place(f"--jobs {jobs}")
        if written is not None and not _is_local(written):
            raise PipelineError(
                "how many trainings run at the same time is for the named runner to say",
                where=str(place),
                fix="leave --jobs out, or use the runner `local`",
            )
        written = Node({"use": Node(LOCAL, place), "jobs": Node(jobs, place)}, place)
    node = written or Node(LOCAL, Place("the runner"))
    item = component_item(RUNNER, node, find, iterations=1)
    if item is None:
        raise PipelineError(
            "the runner is switched off", where=str(node.place), fix="remove `enabled`"
        )
    return build_part(item, 0, device)


def _is_local(node: Node) -> bool:
    return "use" in (written := expand(node)) and written["use"].content == LOCAL
