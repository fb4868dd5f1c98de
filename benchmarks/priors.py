"""Prior models against the truth: `python -m benchmarks.priors`, which `make bench-priors` runs.

Prints its tables; with `--write-docs` also writes them into the docs. Learned matching features and
IterMVS take part where STEREOGS_MODELS holds `FEATURES` and `NETWORK`.
"""

from __future__ import annotations

import argparse
import os
from pathlib import Path

import torch
from rich.console import Console
from rich.table import Table

from benchmarks import priors_depth, priors_stereo
from core_rasterizer import open_device
from registry.toolkit.cache import FOLDER_VARIABLE

PAGE = Path(__file__).parent.parent / "docs" / "prior_accuracy.md"
FEATURES = Path("mc_cnn_fast", "mc_cnn_fast_mb.onnx")
NETWORK = Path("itermvs", "itermvs_blendedmvs.onnx")
_HEAD = """\
# How exact the priors without weights are

<!-- Written by benchmarks/priors.py (`make bench-priors`). Do not edit. -->

`sgm`, `plane_sweep` and `patch_match` need no network; with `cost: features` the first two compare the
learned features of a small one (MC-CNN fast, 0.6 MB), whose inference is then most of the time. Seconds
are from a machine that others share.

## Stereo: `sgm` on rectified pairs with known disparity

Pixels that the other image does not show are left out where the data set marks them. A pixel without an
answer counts with the error of a disparity of 0. The range searched is a tenth more than the largest
disparity of the pair. The default penalties were chosen on these four pairs. The seconds are medians of
three, on {device}.

{stereo}

For comparison, zero-mean normalized cross-correlation of 9x9 windows with plain semi-global matching, in
another implementation on these pairs: 7.6, 8.5, 15.9 and 6.3 % off by more than 2 pixels (cones, tsukuba,
motorcycle, playground); with MC-CNN features 4.8, 6.8, 13.4 and 5.5 %.

"""
_DEPTH = """\
## Multi-view depth: `plane_sweep`, `patch_match` and a network

Default settings, all training views together. The first number is the share of pixels whose depth
another view confirms, as `consistency_dense` does it: at 2 pixels and 5 %, without patches of less than
100 pixels. Then come the shares of these that are right to 1 % and to 3 %.

- The room of the scene `procedural` (252x189) has exact depth. Neighbouring cameras stand 22, 11 and 4.4
  degrees apart with 2, 3 and 6 views. *slanted* are surfaces seen at more than 60 degrees from
  their normal, *even* those with next to no texture.
- Of photographs the truth is the points of the reconstruction from *all* of them that at least three
  see; of bonsai, which brings none, points triangulated from the twelve training views to within a pixel.
- Of an object the silhouette is known. The first number counts its pixels alone, the second is the share of
  all confirmed depths that lie on it: the more, the fewer were made up for the background.
- IterMVS (BlendedMVS weights, 512x384) counts where its confidence is above 0.3.

{depth}

{seconds}

CPU seconds of all threads, on {device}.
"""


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--write-docs", action="store_true", help=f"also write docs/{PAGE.name}")
    arguments = parser.parse_args()
    torch.set_num_threads(1)
    os.environ[FOLDER_VARIABLE] = ""  # answers from the cache would take no time
    models = Path(os.environ.get("STEREOGS_MODELS", "."))
    features = models / FEATURES
    device = open_device()
    stereo = priors_stereo.table(
        priors_stereo.measure(device, features if features.is_file() else None)
    )
    rows = priors_depth.measure(device, models / NETWORK)
    depth, seconds = priors_depth.table(rows), priors_depth.seconds_table(rows)
    if len(stereo) < 2:
        raise SystemExit("set STEREOGS_DATA to the folder that holds stereo_* and the photographs")
    for lines in (stereo, depth, seconds):
        table = Table(*lines[0])
        for line in lines[1:]:
            table.add_row(*line)
        Console().print(table)
    if arguments.write_docs:
        where = f"{device.name} ({device.platform})"
        text = _HEAD.format(device=where, stereo=_markdown(stereo))
        text += _DEPTH.format(device=where, depth=_markdown(depth), seconds=_markdown(seconds))
        PAGE.write_text(text, "utf-8")


def _markdown(lines: list[list[str]]) -> str:
    rows = [lines[0], ["---"] * len(lines[0]), *lines[1:]]
    return "\n".join(f"| {' | '.join(row)} |" for row in rows)


if __name__ == "__main__":
    main()
