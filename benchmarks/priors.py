"""Accuracy of prior models: `python -m benchmarks.priors`, which `make bench-priors` runs.

Prints its tables; with `--write-docs` also writes `benchmarks/tables/priors.md`. Learned matching features
and IterMVS are measured if STEREOGS_MODELS holds `FEATURES` and `NETWORK`.
"""

from __future__ import annotations

import argparse
import os
from pathlib import Path

import torch

from benchmarks import pages, priors_depth, priors_stereo
from core_rasterizer import open_device
from registry.toolkit.cache.entries import FOLDER_VARIABLE
from stereogs.experiments.showing.score_table import markdown

TARGET = "bench-priors"
FEATURES = Path("mc_cnn_fast", "mc_cnn_fast_mb.onnx")
NETWORK = Path("itermvs", "itermvs_blendedmvs.onnx")
_STEREO = """\
## Stereo: `sgm` on rectified pairs with known disparity

Pixels hidden in the other image are excluded where the data set marks them. A pixel without an answer counts
as disparity 0. The search range is 10 % more than the largest disparity of the pair. The default penalties
were chosen on these four pairs. *features* are learned (MC-CNN fast, 0.6 MB); their inference takes most of
the time. Seconds are medians of three, on {device}, shared with other processes.

{stereo}
Another implementation of semi-global matching, with zero-mean normalized cross-correlation of 9x9 windows:
7.6, 8.5, 15.9 and 6.3 % off by more than 2 pixels (cones, tsukuba, motorcycle, playground); with MC-CNN
features 4.8, 6.8, 13.4 and 5.5 %.

"""
_DEPTH = """\
## Multi-view depth: `plane_sweep`, `patch_match` and a network

Default settings, all training views together. The first number is the share of pixels whose depth another
view confirms by the rule of `consistency_dense`: 2 pixels, 5 %, patches of at least 100 pixels. The others
are the shares of these within 1 % and 3 % of the truth.

- The room of the scene `procedural` (252x189) has exact depth. Neighbouring cameras are 22, 11 and 4.4
  degrees apart with 2, 3 and 6 views. *slanted*: surfaces seen at more than 60 degrees from their normal;
  *even*: surfaces almost without texture.
- For photographs the truth is the points that at least three photographs see in the reconstruction from
  *all* photographs; for bonsai, which has no such file, points triangulated from the twelve training views.
- For an object the first number counts the pixels of its silhouette; the second is the share of all confirmed
  depths that lie on it.
- IterMVS (BlendedMVS weights, 512x384) counts where its confidence is above 0.3.

{depth}
{seconds}
CPU seconds of all threads, on {device}.
"""


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--write-docs", action="store_true", help="also write the tables")
    arguments = parser.parse_args()
    torch.set_num_threads(1)
    os.environ[FOLDER_VARIABLE] = ""  # cached answers would take no time
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
    where = f"{device.name} ({device.platform})"
    text = _STEREO.format(device=where, stereo=markdown(stereo[0], stereo[1:], names=2))
    text += _DEPTH.format(
        device=where,
        depth=markdown(depth[0], depth[1:], names=2),
        seconds=markdown(seconds[0], seconds[1:]),
    )
    print(text)
    if arguments.write_docs:
        pages.write_tables("priors", "Accuracy of prior models", TARGET, text)


if __name__ == "__main__":
    main()
