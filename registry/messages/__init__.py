"""Messages to users: suggestions, the terminal, and the command line's help."""

from typing import TYPE_CHECKING

from core_rasterizer.first_use import names_on_first_use

if TYPE_CHECKING:
    from .suggestions import counted, did_you_mean, listing
    from .terminal import PlainConsole
else:
    __getattr__, __dir__ = names_on_first_use(__name__)

__all__ = ["PlainConsole", "counted", "did_you_mean", "listing"]
