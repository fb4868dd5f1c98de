"""`stereogs demo`: the whole thing once, on three views."""

from __future__ import annotations

import argparse
import os
from pathlib import Path

from .output import Verbs, add_device, add_verb, console
from .train import conclude

DATA = "STEREOGS_DATA"
FAVOURITE = "llff_fern"
"""The scene that the demo prefers where there are several."""
POSES = "poses_bounds.npy"
"""What makes a folder an LLFF scene."""

_EPILOG = """\
examples:
  stereogs demo
  STEREOGS_DATA=/data stereogs demo     three photographs of an LLFF scene in /data, not a drawn room

It trains for half a minute on two processor cores, scores views that it has not seen, and writes into
the run folder report.html, a page about the run, and demo.png: truth, render and depth of an unseen
view, side by side.
"""


def add(verbs: Verbs) -> None:
    """Add the verb."""
    parser = add_verb(verbs, "demo", "train on three views and score unseen ones", _EPILOG)
    parser.add_argument("--out", type=Path, metavar="DIR", help="the run folder (default: in runs)")
    add_device(parser)
    parser.set_defaults(run=run)


def run(arguments: argparse.Namespace) -> int:
    """Train the demo's pipeline and show what came out."""
    import shutil
    from importlib import resources

    from ..files import replacing
    from ..pipeline.pipeline import parse_pipeline
    from ..plugins import Plugins
    from ..session import train

    output = console()
    text = resources.files("registry").joinpath("data", "demo.yaml").read_text("utf-8")
    pipeline = parse_pipeline(text, Plugins(), source="demo.yaml", overrides=_scene())
    from ..runs.results import RENDERS
    from ..runs.training_run import in_runs

    run = train(pipeline, out=arguments.out or in_runs, progress=output, device=arguments.device)
    folder = run.folder_or_refuse()
    if run.finished:
        comparison = sorted((folder.path / RENDERS).glob("*_comparison.png"))[0]
        with replacing(folder.path / "demo.png") as temporary:
            shutil.copyfile(comparison, temporary)
    status = conclude(run, output)
    if run.finished:
        output.print(f"truth, render and depth of an unseen view: {folder.path / 'demo.png'}")
    return status


def photographs() -> str | None:
    """Where STEREOGS_DATA has an LLFF scene, as a pipeline writes it; None where it has none.

    The variable names either a scene's own folder or one that holds scenes, of which the demo
    prefers `llff_fern`.
    """
    root = os.environ.get(DATA)
    if not root:
        return None
    if Path(root, POSES).is_file():
        return f"${{{DATA}}}"
    names = sorted(path.parent.name for path in Path(root).glob(f"*/{POSES}"))
    # Without a folder of eighth-size images the demo would not end in minutes.
    small = [name for name in names if Path(root, name, "images_8").is_dir()]
    if not small:
        return None
    return f"${{{DATA}}}/{FAVOURITE if FAVOURITE in small else small[0]}"


def _scene() -> list[str]:
    """The override that puts photographs in place of the drawn room, if there are any."""
    path = photographs()
    return [] if path is None else [f'scene={{use: llff, path: "{path}", train_views: 3}}']
