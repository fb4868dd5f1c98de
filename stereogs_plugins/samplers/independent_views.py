"""`independent_views`: draw the training view with replacement (Binocular3DGS, Han et al. 2024).

By default all views are used before one repeats, as in 3DGS. Put this sampler before all others, which
modify the view that it draws.
"""

from __future__ import annotations

from registry import Register, Sample, Sampler, Settings, Step, hookimpl


class IndependentViews(Sampler[Settings]):
    """A training view drawn uniformly and independently in each iteration."""

    def sample(self, step: Step, sample: Sample) -> Sample:
        """Return the sample with another view, its camera, image and weights."""
        from dataclasses import replace

        import torch

        views = step.scene.train
        view = views[int(torch.randint(len(views), (), generator=self.generator))]
        return replace(
            sample, view=view, camera=view.camera, target=view.image, weights=view.weights
        )


@hookimpl
def stereogs_register_samplers(register: Register[IndependentViews]) -> None:
    register("independent_views", IndependentViews)
