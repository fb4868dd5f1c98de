"""Building blocks for plugins: photographs, networks, views, drawing, web pages, cache, optional packages."""

from typing import TYPE_CHECKING

from core_rasterizer.first_use import names_on_first_use

if TYPE_CHECKING:
    from ..messages.suggestions import counted as counted
    from ..system.files import write_text as write_text
    from .loggers import LoggerSettings as LoggerSettings
    from .optional_package import optional_module as optional_module
    from .spz import spz_bytes as spz_bytes
else:
    __all__, __dir__, __getattr__ = names_on_first_use(__name__)
