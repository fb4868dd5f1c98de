"""`independent_views`: each iteration draws its training view anew (Binocular3DGS, Han et al. 2024).

The host goes through all views before one comes again, as 3DGS does. Put this sampler first: those after
it change what it draws.
"""

from __future__ import annotations

from registry import Register, Sample, Sampler, Settings, Step, hookimpl


class IndependentViews(Sampler[Settings]):
    """A training view drawn uniformly, whatever came before."""

    def sample(self, step: Step, sample: Sample) -> Sample:
        """Return the sample with another view, its camera and its image."""
        from dataclasses import replace

        import torch

        views = step.scene.train
        view = views[int(torch.randint(len(views), (), generator=self.generator))]
        return replace(sample, view=view, camera=view.camera, target=view.image)


@hookimpl
def stereogs_register_samplers(register: Register[IndependentViews]) -> None:
    register("independent_views", IndependentViews)
