"""Building blocks for plugins: photographs, networks, views, drawing, web pages, cache, optional packages."""

from typing import TYPE_CHECKING

from core_rasterizer.first_use import names_on_first_use

if TYPE_CHECKING:
    from ..messages.suggestions import counted
    from ..system.files import write_text
    from .optional_package import optional_module
else:
    __getattr__, __dir__ = names_on_first_use(__name__)

__all__ = ["counted", "optional_module", "write_text"]
