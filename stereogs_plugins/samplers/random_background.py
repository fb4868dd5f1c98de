"""`random_background`: a random background colour in each iteration (3DGS's `random_background`; CoR-GS).

Gaussians then cannot imitate the background, and the fields of CoR-GS train with different noise.
"""

from __future__ import annotations

from dataclasses import replace

from registry import Register, Sample, Sampler, Settings, Step, hookimpl


class RandomBackgroundSettings(Settings):
    opaque: bool = True
    """Use it for opaque photographs too, so that Gaussians must cover them completely."""


class RandomBackground(Sampler[RandomBackgroundSettings]):
    """A colour uniform in [0, 1]^3; photographs with alpha are composited on it too."""

    def sample(self, step: Step, sample: Sample) -> Sample:
        """Return the sample with a random background, or unchanged if the photograph is excluded."""
        import torch
        from torch.nn.functional import interpolate

        target, alpha = sample.target, sample.view.alpha
        if not self.settings.opaque and (alpha is None or bool((alpha == 1).all())):
            return sample
        color = torch.rand(3, generator=self.generator)
        if alpha is not None:
            if alpha.shape != target.shape[:2]:  # another sampler has reduced the photograph
                alpha = interpolate(alpha[None, None], size=target.shape[:2], mode="area")[0, 0]
            change = color - torch.tensor(sample.background)
            target = (target + (1 - alpha)[..., None] * change).clamp(0, 1)
        red, green, blue = color.tolist()
        return replace(sample, target=target, background=(red, green, blue))


@hookimpl
def stereogs_register_samplers(register: Register[RandomBackground]) -> None:
    register("random_background", RandomBackground)
