"""Makes geometry.webp: before and after, and depth beside the truth, in a room whose depth is known exactly.

Run it in the repository's root: `.venv/bin/python docs/images/make_geometry.py`. It prints the scores that
docs/geometry.md says of the pictures.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from pathlib import Path

import torch
from PIL import Image, ImageDraw, ImageFont
from torch import Tensor

import stereogs
from core_rasterizer import Rendering
from registry.toolkit.drawing.pictures import nearness_picture, side_by_side, to_bytes

ROOT = Path(__file__).parents[2]
ROOM = "scene={use: procedural, train_views: 3, width: 400, height: 300}"
METRICS = "metrics=[psnr, ssim, depth_error, depth_within]"
SEEN = 1
"""Which of the test views, and of the training views, is shown."""
CAPTION, WIDTH = 22, 1200


def main() -> None:
    """Train plain 3DGS and `weightfree_fast` on three pictures of the room, write the sheet."""
    first: list[Rendering] = []

    def look(run: stereogs.Run) -> None:
        first.append(run.rendering(run.scene.test[SEEN].camera))

    before = _trained("3dgs_fast.yaml", "initializer={use: sfm, source: triangulate}")
    after = _trained("weightfree_fast.yaml", on_begin=look)
    view, seen = after.scene.test[SEEN], after.scene.train[SEEN]
    renderings = [before.rendering(view.camera), *first, after.rendering(view.camera)]
    names = ["plain 3DGS", "first points", "after 300 iterations"]
    rows = [
        (["a view kept for testing", *names], [view.image, *(r.rgb for r in renderings)]),
        (["its depth", *names], _depths(view, renderings)),
        (
            ["a training view", "depth by plane_sweep", "confirmed", "completed"],
            [after.pictures[f"{seen.name.removesuffix('.png')}_depth"]],
        ),
    ]
    _sheet(rows).save(Path(__file__).with_name("geometry.webp"), quality=80, method=6)


def _trained(
    pipeline: str, *overrides: str, on_begin: Callable[[stereogs.Run], None] | None = None
) -> stereogs.Run:
    built = stereogs.build_pipeline(ROOT / "pipelines" / pipeline, [ROOM, METRICS, *overrides])
    run = stereogs.train(built, on_begin=on_begin)
    print(pipeline, run.model.count, run.scores["test"].mean)
    return run


def _depths(view: stereogs.View, renderings: Sequence[Rendering]) -> Sequence[Tensor]:
    """The view's own and the renderings' depth, one scale of colours for all."""
    truth = view.depth
    assert truth is not None  # the procedural room knows every depth
    near = [1 / truth.clamp(min=1e-9), *(r.alpha / r.depth.clamp(min=1e-9) for r in renderings)]
    known = [truth > 0, *(r.alpha > 0.5 for r in renderings)]
    return nearness_picture(torch.cat(near, 1), torch.cat(known, 1)).chunk(len(near), 1)


def _sheet(rows: Sequence[tuple[Sequence[str], Sequence[Tensor]]]) -> Image.Image:
    """Rows of pictures, each with its captions above."""
    strips = [Image.fromarray(to_bytes(side_by_side(*pictures))) for _, pictures in rows]
    strips = [
        strip.resize((WIDTH, round(strip.height * WIDTH / strip.width)), Image.Resampling.LANCZOS)
        for strip in strips
    ]
    sheet = Image.new("RGB", (WIDTH, sum(CAPTION + strip.height for strip in strips)), "white")
    canvas, font, top = ImageDraw.Draw(sheet), ImageFont.load_default(14), 0
    for (captions, _), strip in zip(rows, strips, strict=True):
        for place, caption in enumerate(captions):
            canvas.text((place * WIDTH // len(captions) + 2, top + 2), caption, "black", font)
        sheet.paste(strip, (0, top + CAPTION))
        top += CAPTION + strip.height
    return sheet


if __name__ == "__main__":
    main()
