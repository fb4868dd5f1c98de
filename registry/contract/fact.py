"""What a scene loader wants on record beside the scene itself."""

from __future__ import annotations

from dataclasses import dataclass

FactValue = str | int | float | tuple[int, ...]


@dataclass(frozen=True)
class Fact:
    """Something about a scene that its loader knows and the scene does not show.

    Args:
        name: a word of letters, digits, "-" and "_", unique among a scene's facts.
        value: what results carry and `stereogs compare` looks at; numbers finite.
        text: the value in words, for people; empty where it speaks for itself.
        affects_scores: whether scores mean something else where the value differs. Runs of one scene
            that differ in such a fact are not compared.
    """

    name: str
    value: FactValue
    text: str = ""
    affects_scores: bool = True

    def __str__(self) -> str:
        if self.text:
            return self.text
        if isinstance(self.value, tuple):
            return ", ".join(map(str, self.value))
        return f"{self.value:g}" if isinstance(self.value, float) else str(self.value)
