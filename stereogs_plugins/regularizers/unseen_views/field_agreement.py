"""`field_agreement`: fields must show the same from where no photograph was taken.

The co-regularization of CoR-GS (Zhang et al. 2024). Where two fields that learn the same photographs
differ, at least one of them is wrong.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from pydantic import Field

from registry import PluginError, Regularizer, Settings, Step
from registry.toolkit.views import virtual_views
from registry.toolkit.views.virtual_views import VirtualViewKind

if TYPE_CHECKING:
    from torch import Tensor


class FieldAgreementSettings(Settings):
    views: VirtualViewKind = "box"
    """Where the virtual camera of each iteration stands: in a box or on a sphere around the training
    cameras, or between two neighbours."""
    ssim_weight: float = Field(0.2, ge=0, le=1)
    """Share of D-SSIM beside L1."""


class FieldAgreement(Regularizer[FieldAgreementSettings]):
    """(1 - ssim_weight) L1 + ssim_weight (1 - SSIM) to each other field's render, which feels nothing.

    Each field draws cameras of its own; what the paper asks of both at one camera, it asks of each at
    another.
    """

    needs_fields = 2

    def loss(self, step: Step) -> Tensor:
        """The sum over the other fields (`training.fields`).

        Raises:
            PluginError: there is a single field.
        """
        import torch

        from core_rasterizer import photometric_loss

        if not step.others:
            raise PluginError(
                "there is no other field to agree with", fix="set `training.fields` to 2"
            )
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
