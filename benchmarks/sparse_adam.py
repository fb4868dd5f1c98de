"""Adam on visible Gaussians only, compared with Adam on all."""

from __future__ import annotations

import time
from statistics import median
from typing import Any

import torch
from torch import Tensor

from core_rasterizer import Adam, Camera, GaussianModel, Gaussians, photometric_loss
from core_rasterizer.layout import PARAMETERS

STEPS = 40
RATES = {
    "means": 1.6e-4,
    "log_scales": 5e-3,
    "quaternions": 1e-3,
    "opacity_logits": 5e-2,
    "sh_constant": 2.5e-3,
    "sh_rest": 2.5e-3 / 20,
}


class Training:
    """Gaussians with disturbed colours, fitted to their original renders."""

    def __init__(self, model: GaussianModel, cameras: list[Camera], visible_only: bool) -> None:
        gaussians = model.gaussians()
        sh = gaussians.sh.clone()
        generator = torch.Generator().manual_seed(2)
        sh[:, 0] += 0.5 * torch.randn(sh[:, 0].shape, generator=generator)
        disturbed = Gaussians(
            gaussians.means,
            gaussians.log_scales,
            gaussians.quaternions,
            gaussians.opacity_logits,
            sh,
        )
        self.cameras = cameras
        self.start = {name: getattr(disturbed, name) for name in PARAMETERS}
        self.model = GaussianModel(disturbed, model.device)
        self.optimizer = Adam(self.model)
        if visible_only:
            self.optimizer.program = model.device.program(
                "optimization/adam_values",
                "optimization/adam",
                dtype=self.model.dtype,
                VISIBLE_ONLY=1,
            )

    def iterate(self, number: int, targets: list[Tensor]) -> tuple[float, float]:
        """Run an iteration; return its seconds and those of the optimizer."""
        view = number % len(targets)
        begin = time.perf_counter()
        self.model.zero_gradients()
        photometric_loss(self.model.render(self.cameras[view]), targets[view]).backward()
        self.model.device.finish()
        middle = time.perf_counter()
        self.optimizer.step(RATES, active_sh_degree=3)
        self.model.device.finish()
        end = time.perf_counter()
        return end - begin, end - middle

    def image(self) -> Tensor:
        with torch.no_grad():
            return self.model.render(self.cameras[0]).rgb

    def movement(self) -> Tensor:
        """Return the change of every parameter, flattened."""
        moved = [self.model.read(name) - self.start[name] for name in PARAMETERS]
        return torch.cat([parameter.flatten() for parameter in moved])


def measure_sparse_adam(model: GaussianModel, cameras: list[Camera]) -> dict[str, Any]:
    """Run both optimizers in turns over the same views.

    Returns:
        `steps`; `dense_ms`, `sparse_ms` of the optimizer; `time_ratio` of whole iterations;
        `movement`, the difference of the final parameters over their change (L2);
        `image_max`, `image_999` as in the other rows; `dense_psnr`, `sparse_psnr` of the fits, dB.
    """
    with torch.no_grad():
        targets = [model.render(camera).rgb for camera in cameras]
    dense, sparse = (Training(model, cameras, visible_only) for visible_only in (False, True))
    times = [
        (dense.iterate(number, targets), sparse.iterate(number, targets)) for number in range(STEPS)
    ]
    movement, image = dense.movement(), dense.image()
    errors = (sparse.image() - image).abs().flatten() / image.abs().max()

    def psnr(training: Training) -> float:
        return float(-10 * torch.log10((training.image() - targets[0]).square().mean()))

    return {
        "steps": STEPS,
        "dense_ms": 1e3 * median(pair[0][1] for pair in times),
        "sparse_ms": 1e3 * median(pair[1][1] for pair in times),
        "time_ratio": median(pair[1][0] / pair[0][0] for pair in times),
        "movement": float((sparse.movement() - movement).norm() / movement.norm()),
        "image_max": float(errors.max()),
        "image_999": float(errors.sort().values[int(0.999 * len(errors))]),
        "dense_psnr": psnr(dense),
        "sparse_psnr": psnr(sparse),
    }
