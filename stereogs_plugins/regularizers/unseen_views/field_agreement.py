"""`field_agreement`: renders of several fields must agree in virtual views.

The co-regularization of CoR-GS (Zhang et al. 2024). Where two fields trained on the same photographs differ,
at least one of them is wrong.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from pydantic import Field

from registry import HostDefaults, Percent, Regularizer, Settings, Step
from registry.toolkit.views import virtual_views
from registry.toolkit.views.virtual_views import VirtualViewKind

if TYPE_CHECKING:
    from torch import Tensor

    from registry import Rendered


class FieldAgreementSettings(Settings):
    views: VirtualViewKind = "box"
    """Positions of the virtual cameras: in a box or on a sphere around the training cameras, or
    between two neighbours."""
    ssim_weight: float = Field(0.2, ge=0, le=1)
    """Weight of D-SSIM; L1 has 1 minus this."""


class FieldAgreement(Regularizer[FieldAgreementSettings]):
    """(1 - ssim_weight) L1 + ssim_weight (1 - SSIM) to each other field's render, without gradient to it.

    Each field draws its own cameras; the paper uses the same camera for both.
    """

    host_defaults = HostDefaults(start=Percent(5))

    @classmethod
    def needs_rendered(cls, settings: FieldAgreementSettings) -> tuple[Rendered, ...]:
        """Return that it compares fields."""
        return ("other_fields",)

    def loss(self, step: Step) -> Tensor:
        """Return the sum over the other fields (`training.fields`)."""
        import torch

        from core_rasterizer import photometric_loss

        camera = virtual_views.draw(self.settings.views, step.scene, self.generator)
        rendered, device = step.render(camera).rgb, step.model.device
        terms = [
            photometric_loss(
                rendered,
                other.render(camera, background=step.sample.background).rgb,
                self.settings.ssim_weight,
                device=device,
            )
            for other in step.others
        ]
        return torch.stack(terms).sum()
