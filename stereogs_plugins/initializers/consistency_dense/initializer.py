"""`consistency_dense`: a point for every pixel whose depth other training views confirm (StereoGS).

Depth priors estimate the depth of every training view; depths that pass the geometric consistency filter
(geometric_consistency.py) are lifted to points. The paper uses nothing else. The folder completion/ adds
guessed depths in holes (`fill`), coarse points behind foreground edges (`back_layer`) and around each image
(`margin`), and merges duplicates (`merge`).
"""

from __future__ import annotations

import logging
from dataclasses import replace
from typing import TYPE_CHECKING, Any

from registry import Initializer, PointCloud, Prior, Register, SceneError, TrainingScene, hookimpl
from registry.priors import MultiViewDepthPrior

from .settings import ConsistencyDenseSettings

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence

    from torch import Tensor

    from .geometric_consistency import SelectedDepth
    from .layers import Layer
    from .projection import DepthImage
    from .scene_analysis.analysis import SceneAnalysis
    from .scene_analysis.plain_background import PlainAreas
    from .view_depth import ViewDepth

_log = logging.getLogger(__name__)

PATCH_STEP = 0.05
"""Relative depth difference between neighbouring pixels of different patches."""


class ConsistencyDense(Initializer[ConsistencyDenseSettings]):
    """Points from multi-view depth priors, filtered by geometric consistency between the views."""

    ablation_baseline = "sfm"
    needs_priors = ("multi_view_depth",)

    def initialize(self, scene: TrainingScene, priors: Mapping[str, Prior[Any]]) -> PointCloud:
        """Return at least one point, with facts, pictures and confirmed depths of up to `max_views` views.

        Raises:
            PluginError: the pipeline has no multi-view depth prior of a name in `prior`, or `prior` is
                null and the number of such priors is not one.
            SceneError: one training view, fewer other views than must agree, or no confirmed depth.
        """
        import numpy as np

        from .completion.guesses import guesses
        from .completion.matched import matched_or_confirmed
        from .scene_analysis.analysis import SceneAnalysis
        from .scene_analysis.contradictions import without_outvoted
        from .scene_analysis.plain_background import PlainAreas
        from .view_depth import ViewDepth
        from .visibility import spread

        settings, all_views = self.settings, len(scene.train)
        scene = replace(scene, train=spread(scene.train, settings.max_views))
        if len(scene.train) < all_views:
            _log.info("%s: depth of %d of %d views", scene.name, len(scene.train), all_views)
        min_consistent = self._min_consistent(scene)
        areas = PlainAreas.of(scene.train)
        selected = self._selected_depths(scene, priors, min_consistent, areas)
        confirmed = self._confirmed(scene, selected)
        analysis = SceneAnalysis.of(scene.train, areas, confirmed)
        _log.info("%s: %s", scene.name, analysis.summary)
        confirmed = analysis.without_background(confirmed)
        if analysis.wide:
            confirmed = without_outvoted(scene.train, confirmed, scene.bounds)
        guessed = None
        if settings.fill:
            guessed = guesses(
                scene,
                confirmed,
                analysis,
                background_range=settings.background_range,
                also_shown=settings.fill_shown,
                planes=settings.fill_planes and analysis.kind == "forward-facing",
            )
        filled = guessed or [np.zeros_like(depth) for depth in confirmed]
        views = [
            ViewDepth(view, choice.depth, *depths)
            for view, choice, *depths in zip(scene.train, selected, confirmed, filled, strict=True)
        ]
        points = self._point_cloud(self._layers(scene, views, analysis), views, analysis)
        if settings.fill and guessed is None:
            return matched_or_confirmed(scene, points, self.context.seed, self._chosen)
        return points

    def _selected_depths(
        self,
        scene: TrainingScene,
        priors: Mapping[str, Prior[Any]],
        min_consistent: int,
        areas: PlainAreas,
    ) -> list[SelectedDepth]:
        import numpy as np

        from .geometric_consistency import Limits, most_confirmed

        settings, depths_by_prior = self.settings, []
        for name in self._prior_names(scene, areas):
            maps = MultiViewDepthPrior.choose(priors, name).depths(scene.train, scene.bounds)
            valid = [
                m.valid if view.trained is None else m.valid & view.trained
                for m, view in zip(maps, scene.train, strict=True)
            ]
            depths_by_prior.append(
                [
                    np.where(known.numpy(), m.depth.numpy(), np.float32(0))
                    for m, known in zip(maps, valid, strict=True)
                ]
            )
        limits = Limits(
            settings.max_reprojection_error, settings.max_depth_error, min_consistent, scene.bounds
        )
        return most_confirmed([view.camera for view in scene.train], depths_by_prior, limits)

    def _prior_names(self, scene: TrainingScene, areas: PlainAreas) -> tuple[str | None, ...]:
        """Names of the priors for this scene; None stands for the pipeline's only one."""
        from .scene_analysis.analysis import SceneAnalysis

        names = self.settings.prior
        if isinstance(names, dict):
            names = names[SceneAnalysis.without_depths(scene.train, areas).kind]
        return names if isinstance(names, tuple) else (names,)

    def _min_consistent(self, scene: TrainingScene) -> int:
        from .geometric_consistency import default_min_consistent

        others = len(scene.train) - 1
        if others < 1:
            raise SceneError(
                "depths cannot be confirmed: the scene has one training view",
                where=scene.name,
                fix="use two or more training views, or the initializer `random`",
            )
        needed = self.settings.min_consistent or default_min_consistent(len(scene.train))
        if needed > others:
            raise SceneError(
                f"{needed} other views must confirm a depth (`min_consistent`), but {others} have one",
                where=scene.name,
                fix=f"set `min_consistent` to at most {others}, or use more views (up to `max_views`)",
            )
        return needed

    def _confirmed(
        self, scene: TrainingScene, selected: Sequence[SelectedDepth]
    ) -> list[DepthImage]:
        """Confirmed depths of each view, without small patches."""
        from registry.toolkit.progress import in_parallel

        from .geometric_consistency import without_small_patches

        least = self.settings.min_component
        confirmed = in_parallel(
            lambda choice: without_small_patches(
                choice.confirmed, min_pixels=least, max_step=PATCH_STEP
            ),
            selected,
        )
        empty = [view.name for view, d in zip(scene.train, confirmed, strict=True) if not d.any()]
        if len(empty) == len(confirmed):
            raise SceneError(
                f"the {len(empty)} training views agree on the depth of no pixel",
                where=scene.name,
                fix="choose views that overlap, check the poses, or raise `max_reprojection_error` "
                "and `max_depth_error`",
            )
        for name in empty:
            _log.warning("no other view confirms any depth of %s; it gives no points", name)
        return confirmed

    def _layers(
        self, scene: TrainingScene, views: list[ViewDepth], analysis: SceneAnalysis
    ) -> dict[str, Layer]:
        """Points by kind, without those that silhouettes refute."""
        from .completion.merging import back_layers, margins, surfaces
        from .layers import is_background

        settings, bounds = self.settings, scene.bounds
        layers = surfaces(views, bounds, stride=settings.stride, merge=settings.merge)
        coarse = {}
        if settings.back_layer:
            coarse["back_layer"] = back_layers(views, bounds)
        if settings.margin:
            coarse["margin"] = margins(views, bounds)
        for kind, layer in coarse.items():
            empty = is_background(layer.colors, scene.background, settings.background_range)
            layers[kind] = layer.without(empty)
        return {
            kind: layer.without(analysis.refutes(layer.positions, guessed=kind != "confirmed"))
            for kind, layer in layers.items()
        }

    def _chosen(self, count: int) -> Tensor:
        """Sorted indices of the points to keep."""
        import torch

        most = self.settings.max_points
        if most is None or count <= most:
            return torch.arange(count)
        return torch.randperm(count, generator=self.generator)[:most].sort().values

    def _point_cloud(
        self, layers: dict[str, Layer], views: list[ViewDepth], analysis: SceneAnalysis
    ) -> PointCloud:
        import torch

        from registry.toolkit.progress import in_parallel

        from .completion.merging import hidden
        from .layers import joined
        from .view_depth import PICTURE_COLUMNS, ViewDepth

        settings, points = self.settings, joined(list(layers.values()))
        chosen = self._chosen(len(points))
        sizes = torch.tensor([len(layer) for layer in layers.values()])
        layer_of = torch.arange(len(layers)).repeat_interleave(sizes)[chosen]
        counts = torch.bincount(layer_of, minlength=len(layers)).tolist()
        kinds = {kind: layer_of == number for number, kind in enumerate(layers)}
        if "back_layer" in layers and analysis.kind != "object":
            behind = kinds["back_layer"]
            kinds["hidden"] = behind.clone()
            positions = points.positions[chosen[behind].numpy()]
            kinds["hidden"][behind] = torch.from_numpy(hidden(positions, views))
        scales = opacities = None
        if settings.sigma is not None:
            scales = (settings.sigma * torch.from_numpy(points.spacings)[chosen]).float()
        if settings.opacity is not None:
            opacities = torch.full((len(chosen),), settings.opacity)
        names = [f"{view.view.name.removesuffix('.png')}_depth" for view in views]
        return PointCloud(
            positions=torch.from_numpy(points.positions)[chosen].float(),
            colors=torch.from_numpy(points.colors)[chosen].clamp(0, 1),
            scales=scales,
            opacities=opacities,
            facts={
                **analysis.facts(),
                "points_by_kind": dict(zip(layers, counts, strict=True)),
                "picture_columns": list(PICTURE_COLUMNS),
                "views_without_confirmed_depth": sum(not v.confirmed.any() for v in views),
                "views": {view.view.name: view.facts() for view in views},
            },
            pictures=dict(zip(names, in_parallel(ViewDepth.picture, views), strict=True)),
            maps={v.view.name: v.confirmed_map() for v in views} if settings.hand_on_depth else {},
            kinds=kinds,
        )


@hookimpl
def stereogs_register_initializers(register: Register[ConsistencyDense]) -> None:
    register("consistency_dense", ConsistencyDense)
