"""`consistency_dense`: a point for every pixel whose depth other training views confirm (StereoGS).

One or more multi-view depth priors are asked for every training view's depth; what the views agree on is
lifted to points. Three switches complete the picture where they do not: guessed depths in holes (`fill`),
coarse points behind foreground edges (`back_layer`) and around each image (`margin`). The paper uses none.
"""

from __future__ import annotations

import logging
from typing import TYPE_CHECKING, Any

from registry import Initializer, PointCloud, Prior, Register, SceneError, TrainingScene, hookimpl
from registry.priors import MultiViewDepthPrior

from .settings import ConsistencyDenseSettings

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence

    from torch import Tensor

    from .confirming.several_priors import Choice
    from .layers import Layer
    from .projection import DepthImage, Floats
    from .understanding.plain_background import PlainAreas
    from .understanding.understanding import Understanding
    from .view_depth import ViewDepth

_log = logging.getLogger(__name__)

PATCH_STEP = 0.05
"""Relative depth difference from which on neighbouring pixels belong to different patches."""


class ConsistencyDense(Initializer[ConsistencyDenseSettings]):
    """Points from a multi-view depth prior, filtered by agreement between the views."""

    ablation_baseline = "sfm"
    needs_priors = ("multi_view_depth",)

    def initialize(self, scene: TrainingScene, priors: Mapping[str, Prior[Any]]) -> PointCloud:
        """Return at least one point, with facts, a picture and the confirmed depth of each training view.

        Raises:
            PluginError: the pipeline has no multi-view depth prior of a name in `prior`, or `prior` is
                null and there is none or more than one.
            SceneError: one training view, fewer other views than must agree, or views that agree on
                nothing.
        """
        from .understanding.contradictions import without_outvoted
        from .understanding.plain_background import PlainAreas
        from .understanding.understanding import Understanding
        from .view_depth import ViewDepth

        needed = self._min_consistent(scene)
        areas = PlainAreas.of(scene.train)
        choices = self._choices(scene, priors, needed, areas)
        confirmed = self._confirmed(scene, choices)
        shown = Understanding.of(scene.train, areas, confirmed)
        _log.info("%s: %s", scene.name, shown.sentence)
        confirmed = shown.without_background(confirmed)
        if shown.wide:
            confirmed = without_outvoted(scene.train, confirmed, scene.bounds)
        guessed = self._guessed(scene, confirmed, shown)
        views = [
            ViewDepth(view, choice.answer, sure, found)
            for view, choice, sure, found in zip(
                scene.train, choices, confirmed, guessed or _nothing(confirmed), strict=True
            )
        ]
        points = self._point_cloud(self._layers(scene, views, shown), views, shown)
        return self._matched(scene, points) if guessed is None else points

    def _choices(
        self,
        scene: TrainingScene,
        priors: Mapping[str, Prior[Any]],
        needed: int,
        areas: PlainAreas,
    ) -> list[Choice]:
        """Each view's depths, of the priors that are asked."""
        import numpy as np

        from .confirming.geometric_filter import Limits
        from .confirming.several_priors import most_confirmed

        settings, answers = self.settings, []
        for name in self._names(scene, areas):
            maps = MultiViewDepthPrior.choose(priors, name).depths(scene.train, scene.bounds)
            answers.append(
                [np.where(m.valid.numpy(), m.depth.numpy(), np.float32(0)) for m in maps]
            )
        limits = Limits(
            reprojection=settings.max_reprojection_error,
            depth=settings.max_depth_error,
            views=needed,
            bounds=scene.bounds,
        )
        return most_confirmed([view.camera for view in scene.train], answers, limits)

    def _names(self, scene: TrainingScene, areas: PlainAreas) -> tuple[str | None, ...]:
        """Of the priors that this scene's depths are asked of; None: the pipeline's only one."""
        from .understanding.understanding import Understanding

        names = self.settings.prior
        if isinstance(names, dict):
            names = names[Understanding.at_first_sight(scene.train, areas).kind]
        return names if isinstance(names, tuple) else (names,)

    def _min_consistent(self, scene: TrainingScene) -> int:
        from .confirming.geometric_filter import default_min_consistent

        others = len(scene.train) - 1
        if others < 1:
            raise SceneError(
                "views cannot confirm each other's depth: there is one training view",
                where=scene.name,
                fix="use two or more training views, or the initializer `random`",
            )
        needed = self.settings.min_consistent or default_min_consistent(len(scene.train))
        if needed > others:
            raise SceneError(
                f"{needed} other views must confirm a depth (`min_consistent`), there are {others}",
                where=scene.name,
                fix=f"set `min_consistent` to at most {others}, or use more training views",
            )
        return needed

    def _confirmed(self, scene: TrainingScene, choices: Sequence[Choice]) -> list[DepthImage]:
        """Confirmed depths of each view, without small patches."""
        from registry.toolkit.photos import in_parallel

        from .confirming.geometric_filter import without_small_patches

        least = self.settings.min_component
        confirmed = in_parallel(
            lambda choice: without_small_patches(
                choice.confirmed, min_pixels=least, max_step=PATCH_STEP
            ),
            choices,
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

    def _guessed(
        self, scene: TrainingScene, confirmed: list[DepthImage], shown: Understanding
    ) -> list[DepthImage] | None:
        """Depths for the holes of each view, none if none are wanted; None: too little is confirmed."""
        from .completing.guesses import guesses

        if not self.settings.fill:
            return _nothing(confirmed)
        found = guesses(
            scene,
            confirmed,
            shown,
            background_range=self.settings.background_range,
            also_shown=self.settings.fill_shown,
        )
        if found.worthwhile:
            return found.depths
        _log.warning(
            "%s: other views confirm %.0f %% of the surface, too little to guess the rest from; more "
            "photographs, or some nearer to each other, would help",
            scene.name,
            100 * found.confirmed_share,
        )
        return None

    def _matched(self, scene: TrainingScene, points: PointCloud) -> PointCloud:
        """Points of matched features in place of the few that are confirmed, if there are enough."""
        from .matched import matched_points

        found = matched_points(scene, points, self.context.seed, self._chosen)
        if found is None:
            return points
        _log.info("%s: it starts from %d matched features instead", scene.name, len(found))
        return found

    def _layers(
        self, scene: TrainingScene, views: list[ViewDepth], shown: Understanding
    ) -> dict[str, Layer]:
        """Points by kind, without those that the silhouettes refute."""
        from .cloud import back_layers, margins, surfaces
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
            kind: layer.without(shown.refutes(layer.positions, guessed=kind != "confirmed"))
            for kind, layer in layers.items()
        }

    def _chosen(self, count: int) -> Tensor:
        """Indices of the points that are kept, in order."""
        import torch

        if self.settings.max_points is None or count <= self.settings.max_points:
            return torch.arange(count)
        shuffled = torch.randperm(count, generator=self.generator)
        return shuffled[: self.settings.max_points].sort().values

    def _point_cloud(
        self, layers: dict[str, Layer], views: list[ViewDepth], shown: Understanding
    ) -> PointCloud:
        import torch

        from registry.toolkit.photos import in_parallel

        from .layers import joined
        from .view_depth import PICTURE_COLUMNS, ViewDepth

        settings, points = self.settings, joined(list(layers.values()))
        chosen = self._chosen(len(points))
        sizes = torch.tensor([len(layer) for layer in layers.values()])
        layer_of = torch.arange(len(layers)).repeat_interleave(sizes)[chosen]
        counts = torch.bincount(layer_of, minlength=len(layers)).tolist()
        kinds = {kind: layer_of == number for number, kind in enumerate(layers)}
        if "back_layer" in layers and shown.kind != "object":
            behind = kinds["back_layer"]
            kinds["hidden"] = behind.clone()
            kinds["hidden"][behind] = _hidden(points.positions[chosen[behind].numpy()], views)
        scales = None
        if settings.sigma is not None:
            scales = (settings.sigma * torch.from_numpy(points.spacings)[chosen]).float()
        opacities = None
        if settings.opacity is not None:
            opacities = torch.full((len(chosen),), settings.opacity)
        return PointCloud(
            positions=torch.from_numpy(points.positions)[chosen].float(),
            colors=torch.from_numpy(points.colors)[chosen].clamp(0, 1),
            scales=scales,
            opacities=opacities,
            facts={
                **shown.facts(),
                "points_by_kind": dict(zip(layers, counts, strict=True)),
                "picture_columns": list(PICTURE_COLUMNS),
                "views_without_confirmed_depth": sum(not v.confirmed.any() for v in views),
                "views": {view.view.name: view.facts() for view in views},
            },
            pictures=dict(
                zip(
                    (f"{view.view.name.removesuffix('.png')}_depth" for view in views),
                    in_parallel(ViewDepth.picture, views),
                    strict=True,
                )
            ),
            maps={v.view.name: v.confirmed_map() for v in views} if settings.hand_on_depth else {},
            kinds=kinds,
        )


def _hidden(points: Floats, views: Sequence[ViewDepth]) -> Tensor:
    """Which world points `[P, 3]` no view can see, `[P]` bool."""
    import torch

    from .other_views import in_sight

    cameras, depths = [view.camera for view in views], [view.completed for view in views]
    return torch.from_numpy(~in_sight(points, cameras, depths))


def _nothing(depths: Sequence[DepthImage]) -> list[DepthImage]:
    import numpy as np

    return [np.zeros_like(depth) for depth in depths]


@hookimpl
def stereogs_register_initializers(register: Register[ConsistencyDense]) -> None:
    register("consistency_dense", ConsistencyDense)
