"""Generated Gaussians on surfaces, similar to a trained scene."""

from __future__ import annotations

import numpy as np
import torch

from core_rasterizer import Camera, Gaussians

WIDTH, HEIGHT, FOCAL = 504, 378, 407.0


def surfaces(count: int, width: int = WIDTH, height: int = HEIGHT) -> tuple[Gaussians, Camera]:
    """Return flat discs on wavy walls with clutter behind, spread evenly over the image, and a camera.

    A disc's standard deviation is three quarters of the mean distance to its neighbours on the
    image, so that all counts cover it about equally; some 5 % of the light passes through.
    """
    generator = np.random.default_rng(0)
    focal = FOCAL * width / WIDTH
    u = generator.uniform(-10, width + 10, count)
    v = generator.uniform(-10, height + 10, count)
    clutter = (generator.random(count) < 0.3) * generator.uniform(0, 3, count)
    z = 4 + 1.5 * np.sin(u / width * 5.6) + 0.8 * np.cos(v / height * 6.3) + clutter
    means = np.stack([(u - width / 2) / focal * z, (v - height / 2) / focal * z, z], 1)
    size = 0.75 * np.sqrt(width * height / count) * z / focal
    shape = np.concatenate(
        [generator.uniform(0.7, 1.4, (count, 2)), np.full((count, 1), 0.1)], axis=1
    )
    tilt = np.concatenate([np.ones((count, 1)), 0.3 * generator.normal(size=(count, 3))], axis=1)
    arrays = {
        "means": means,
        "log_scales": np.log(size[:, None] * shape),
        "quaternions": tilt,
        "opacity_logits": generator.uniform(-1, 4, count),
        "sh": 0.1 * generator.normal(size=(count, 16, 3)),
    }
    gaussians = Gaussians(**{k: torch.tensor(a, dtype=torch.float32) for k, a in arrays.items()})
    camera = Camera(torch.eye(4), focal, focal, width / 2, height / 2, width, height)
    return gaussians, camera
