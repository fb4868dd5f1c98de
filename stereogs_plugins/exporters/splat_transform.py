"""`sog`: converted from a PLY file by PlayCanvas's program splat-transform."""

from __future__ import annotations

from typing import TYPE_CHECKING

from registry import Exporter, PluginError, Register, Scene, Settings, hookimpl

if TYPE_CHECKING:
    from pathlib import Path

    from core_rasterizer import GaussianReader

PROGRAM = "splat-transform"
PACKAGE = "@playcanvas/splat-transform"
FILE = "scene.sog"


class SogExporter(Exporter[Settings]):
    """Writes scene.sog, PlayCanvas's compressed format for the web; and scene.ply, its source.

    The program must be on the PATH.
    """

    def export(self, model: GaussianReader, scene: Scene, folder: Path) -> list[Path]:
        """Write scene.ply, convert it, and return the path of the converted file.

        Raises:
            PluginError: the program is missing or failed; scene.ply is kept, for the command in the message.
        """
        import shutil
        import subprocess

        from core_rasterizer import save_ply

        ply, target = folder / "scene.ply", folder / FILE
        save_ply(model.gaussians(), ply)
        # Without "--gpu cpu" it requires a GPU with WebGPU.
        options = ["--quiet", "--overwrite", "--gpu", "cpu", str(ply), str(target)]
        program = shutil.which(PROGRAM)
        if program is None:
            raise PluginError(
                f"the program {PROGRAM} is not on the PATH; {ply} was written",
                fix=_command(["npx", PACKAGE, *options]),
            )
        done = subprocess.run([program, *options], capture_output=True, text=True, check=False)
        if done.returncode or not target.is_file():
            output = (done.stderr or done.stdout).strip()
            raise PluginError(
                f"{PROGRAM} failed with exit status {done.returncode}: {output[-500:]}",
                fix=_command([PROGRAM, *options[1:]]),
            )
        return [target]


def _command(words: list[str]) -> str:
    import shlex

    return f"run: {shlex.join(words)}"


@hookimpl
def stereogs_register_exporters(register: Register[SogExporter]) -> None:
    register("sog", SogExporter)
