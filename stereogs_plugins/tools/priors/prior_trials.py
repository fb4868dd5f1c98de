"""Which installed prior can run an ONNX file, with which settings: guessed, and then tried.

The host knows no network. Each prior says what it would try (`Prior.settings_for`); each of these is
asked about a scene whose depths are known, and the one with the least error is the best guess.
"""

from __future__ import annotations

import time
from collections.abc import Sequence
from dataclasses import dataclass
from importlib import resources
from typing import TYPE_CHECKING, Any

from registry import PluginError, Prior
from registry.contract import HOOK_POINTS
from registry.inspection import find_loader, load
from registry.pipeline import (
    HostSettings,
    Item,
    Place,
    apply_override,
    blamed,
    build_part,
    escape_variables,
    parse,
    plain,
    to_yaml,
    validate_settings,
)
from registry.plugins import Offer, Plugins

from .prior_truth import Score, Truth, judge, truth_of

if TYPE_CHECKING:
    from core_rasterizer import Device
    from registry.toolkit.networks import OnnxModel

_PRIORS = next(point for point in HOOK_POINTS if point.section == "priors")
_SCENE = "prior_check.yaml"


@dataclass(frozen=True)
class Guess:
    """A prior with the settings that it would run a file with.

    Args:
        settings: plain values, as a pipeline holds them.
    """

    offer: Offer
    settings: dict[str, Any]

    def to_yaml(self) -> str:
        """As a pipeline writes it."""
        return to_yaml({"priors": [escape_variables({"use": self.offer.name, **self.settings})]})


@dataclass(frozen=True)
class Trial:
    """A guess and what came of it.

    Args:
        score: how near to the truth its answer is.
        seconds: for one answer.
    """

    guess: Guess
    score: Score
    seconds: float


def guesses(model: OnnxModel, plugins: Plugins, changes: Sequence[str] = ()) -> list[Guess]:
    """What the installed priors would try, in the order of their names.

    Args:
        changes: `key=value`, settings that stand in place of the guessed ones.

    Raises:
        PluginError: no prior knows a file of this form.
        PipelineError: a change that cannot be read.
    """
    found = [
        Guess(offer, _changed(offer, dict(settings), changes))
        for offer in plugins.all()
        if offer.point is _PRIORS and issubclass(offer.component, Prior)
        for settings in offer.component.settings_for(model)
    ]
    if not found:
        raise PluginError(
            "no installed prior knows a file of this form",
            where=str(model.path),
            fix="see docs/prior_models.md for the inputs and outputs that priors take; a file of another "
            "form needs a plugin of its own, whose `settings_for` recognizes it",
        )
    return [guess for place, guess in enumerate(found) if guess not in found[:place]]


def known_truth(plugins: Plugins, device: Device) -> Truth:
    """The scene that guesses are tried on.

    Raises:
        ExplainedError: what its loader says.
    """
    with resources.as_file(resources.files(__package__).joinpath(_SCENE)) as path:
        found = find_loader(path, plugins)
        scene = load(build_part(found.item, found.seed, device))
    return truth_of(scene.train, scene.bounds)


def attempt(guess: Guess, truth: Truth, device: Device) -> Trial:
    """Build the prior, ask it, compare.

    Raises:
        ExplainedError: settings that the prior does not have, or a graph that fails.
    """
    place = Place("the guessed settings")
    settings = validate_settings(
        guess.offer.settings_type,
        parse(to_yaml(escape_variables(guess.settings)), place.source),
        f"{_PRIORS.section}.{guess.offer.name}",
    )
    name = guess.offer.name
    item = Item(name, settings, HostSettings(use=name), guess.offer, place)
    prior = build_part(item, 0, device).component
    begin = time.perf_counter()
    with blamed(item):
        score = judge(prior, truth)
    return Trial(guess, score, time.perf_counter() - begin)


def _changed(offer: Offer, settings: dict[str, Any], changes: Sequence[str]) -> dict[str, Any]:
    written = to_yaml({_PRIORS.section: [escape_variables({"use": offer.name, **settings})]})
    root = parse(written, "the guessed settings")
    for text in changes:
        apply_override(root, f"{_PRIORS.section}.{offer.name}.{text}")
    assert isinstance(root.content, dict)
    (item,) = plain(root.content[_PRIORS.section])
    return {key: value for key, value in item.items() if key != "use"}
