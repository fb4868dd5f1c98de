"""What a run did, in sentences."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator, Mapping

    from registry import Fact, Scene


def lead(results: Mapping[str, Any], scene: Scene) -> str:
    """Return what was made from what, in how long, and how good it is, in one or two sentences."""
    gaussians = f"{results['gaussians']:,} Gaussians" if "gaussians" in results else "Gaussians"
    text = f"{gaussians} from {photographs(len(scene.train))}"
    if "seconds" in results:
        text += f", trained in {seconds(results['seconds'])}"
    if "device" in results:
        text += f" on {results['device'].get('name')}"
    hurried = results.get("initialization", {}).get("hurried", "")
    text = f"{text}. {label(hurried)}" if hurried else f"{text}."
    for found in results.get("recoveries", ()):
        text += (
            f" In iteration {found['iteration']} a parameter was not finite; training went back to "
            f"iteration {found['back_to']} with learning rates times {found['rates']:g}."
        )
    for edit in results.get("edits", ()):
        text += (
            f" {edit['removed']:,} of {edit['gaussians']:,} Gaussians of the run {edit['folder']} were "
            f"removed by hand ({edit['by']}); scores are of those that remain."
        )
    return text


def kind_of_scores(scene: Scene) -> str:
    """Return which photographs the scores are of, and what that means."""
    if scene.test:
        return (
            f"Scores are of {photographs(len(scene.test))} held out from training: they measure how well "
            "views without a photograph are rendered."
        )
    return (
        "Every photograph was trained on, so scores are of training photographs: they do not measure how "
        "well other views are rendered. To measure that, --test-every 8 holds out every 8th photograph."
    )


def about_photographs(scene: Scene) -> list[str]:
    """Return a sentence for the pictures, and one for each fact that the scene loader reported."""
    camera = scene.train[0].camera
    trained = _names([view.name for view in scene.train])
    held_out = _names([view.name for view in scene.test]) or "none"
    return [
        f"{camera.width} x {camera.height} pixels. Trained on: {trained}. Held out: {held_out}.",
        *_sentences(scene.facts),
    ]


def photographs(count: int) -> str:
    """Return a number of photographs in words."""
    return f"{count:,} photograph{'s' if count != 1 else ''}"


def seconds(value: float) -> str:
    """Return a time as a person says it."""
    minutes, rest = divmod(round(value), 60)
    return f"{minutes} min {rest} s" if minutes else f"{value:.3g} s"


def label(name: str) -> str:
    """Return the name of a value as text: a capital letter, and spaces instead of underscores."""
    return f"{name[:1].upper()}{name[1:]}".replace("_", " ")


def _names(names: list[str]) -> str:
    return ", ".join(names)


def _sentences(facts: tuple[Fact, ...]) -> Iterator[str]:
    for fact in facts:
        known = _KNOWN.get(fact.name)
        text = f"{label(fact.name)}: {fact}." if known is None else known(fact)
        if text:
            yield text.replace("..", ".")


def _turned(fact: Fact) -> str:
    return f"{photographs(_count(fact))} turned upright by EXIF." if fact.value else ""


def _focal_lengths(fact: Fact) -> str:
    if not fact.value:
        return "No photograph states its focal length; it was estimated."
    return f"The EXIF data of {photographs(_count(fact))} state the focal length."


def _lenses(fact: Fact) -> str:
    return (
        "All photographs have one lens." if fact.value == 1 else f"{fact.value} different lenses."
    )


def _changed(fact: Fact) -> str:
    return "" if fact.value == "nothing" else f"Photographs were {fact}."


def _count(fact: Fact) -> int:
    return int(str(fact.value))


def _nothing(fact: Fact) -> str:
    return ""


_KNOWN: dict[str, Callable[[Fact], str]] = {
    "changed": _changed,
    "focal_lengths_by_exif": _focal_lengths,
    "lenses": _lenses,
    "turned_upright": _turned,
    "train_photographs": _nothing,  # the names are listed
    "test_photographs": _nothing,
}
"""Facts of the built-in scene loaders whose value needs more than its name."""
