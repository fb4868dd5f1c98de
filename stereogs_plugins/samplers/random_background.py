"""`random_background`: another colour behind each render (3DGS's `random_background`; CoR-GS).

Gaussians can then not stand in for the background, and the fields of CoR-GS learn from different noise.
"""

from __future__ import annotations

from dataclasses import replace

from registry import Register, Sample, Sampler, Settings, Step, hookimpl


class RandomBackgroundSettings(Settings):
    opaque: bool = True
    """Whether photographs that are opaque get one too, so that Gaussians must cover all of them."""


class RandomBackground(Sampler[RandomBackgroundSettings]):
    """A colour uniform in [0, 1]^3; photographs with an alpha are put on it too."""

    def sample(self, step: Step, sample: Sample) -> Sample:
        """Return the sample before a random background; as it is, if it is to have none."""
        import torch
        from torch.nn.functional import interpolate

        target, alpha = sample.target, sample.view.alpha
        if not self.settings.opaque and (alpha is None or bool((alpha == 1).all())):
            return sample
        color = torch.rand(3, generator=self.generator)
        if alpha is not None:
            if (
                alpha.shape != target.shape[:2]
            ):  # a sampler has shrunk the photograph, by means of its pixels
                alpha = interpolate(alpha[None, None], size=target.shape[:2], mode="area")[0, 0]
            behind = torch.tensor(sample.background)
            target = (target + (1 - alpha)[..., None] * (color - behind)).clamp(0, 1)
        red, green, blue = color.tolist()
        return replace(sample, target=target, background=(red, green, blue))


@hookimpl
def stereogs_register_samplers(register: Register[RandomBackground]) -> None:
    register("random_background", RandomBackground)
