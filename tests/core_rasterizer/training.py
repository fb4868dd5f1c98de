"""A short optimization with all features, for tests of repeatability."""

from __future__ import annotations

import hashlib
from typing import Any

import torch

from core_rasterizer import (
    Adam,
    Device,
    Edit,
    GaussianModel,
    apply_edit,
    list_devices,
    photometric_loss,
)
from tests.core_rasterizer.options import posed, smoothing_of
from tests.core_rasterizer.scenes import parameters, random_camera, rates
from tests.core_rasterizer.slanted_wall import matching_digest

RATES = rates(1e-2)


def short_training(
    device: Device, count: int = 300, width: int = 80, height: int = 60, steps: int = 12
) -> str:
    """Fit Gaussians to two images, with topology edits and resets; return a digest of the results.

    Every other step uses a pose gradient and half a band, every fourth smoothing.
    """
    generator = torch.Generator().manual_seed(0)
    cameras = [random_camera(generator, width, height) for _ in range(2)]
    targets = [torch.rand(height, width, 3, generator=generator) for _ in cameras]
    model = GaussianModel(parameters(count), device)
    optimizer = Adam(model)
    losses = []
    for step in range(steps):
        model.zero_gradients()
        factors = torch.rand(model.count, generator=generator) if step % 3 == 2 else None
        camera, pose = posed(cameras[step % 2])
        options: dict[str, Any] = {}
        if step % 4 == 3:
            options["smoothing"] = smoothing_of(generator, model.count)
        rendering = model.render(
            camera if step % 2 else cameras[0],
            background=(0.1, 0.2, 0.3),
            sh_degree=min(3, step / 2),
            opacity_scale=factors,
            collect_statistics=True,
            **options,
        )
        loss = photometric_loss(rendering.rgb, targets[step % 2], device=device)
        (loss + 0.01 * rendering.depth.mean() + 0.1 * rendering.alpha.mean()).backward()
        optimizer.step(RATES, active_sh_degree=min(3, step / 2))
        losses.append(loss.item())
        if pose.grad is not None:
            losses += pose.grad.flatten().tolist()
        if step % 5 == 4:
            busy = model.statistics.screen_gradient() > model.statistics.screen_gradient().median()
            large = model.scales().amax(dim=1) > 0.2
            faint = model.opacities() < 0.1
            apply_edit(model, optimizer, Edit(busy & ~large, busy & large, faint), generator)
            model.write("opacity_logits", model.read("opacity_logits") - 0.1)
            optimizer.reset_moments("opacity_logits")
    digest = hashlib.sha256(repr(losses).encode())
    digest.update(model.digest().encode())
    for moments in optimizer.state().values():
        digest.update(moments.contiguous().numpy().tobytes())
    return digest.hexdigest()


def main() -> None:
    """For every device: the compute units, the raster variant, and digests of training and matching."""
    for device in list_devices():
        for variant in ("cpu", "gpu"):
            engine = device.as_variant(variant)
            digests = short_training(engine), matching_digest(engine)
            print(engine.compute_units, variant, *digests, sep="\t")


if __name__ == "__main__":
    main()
