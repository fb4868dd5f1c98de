"""Progress of slow work, for the bar on the terminal and for the watchdog.

    from registry.toolkit.progress import progress, tracked

    for view in tracked(views, "depth"):       before each view: "depth 3/12"
        ...
    progress("matching", done, total)          where there is no loop

A verb shows what its components report within `with showing(console()):`.
"""

from typing import TYPE_CHECKING

from core_rasterizer.first_use import names_on_first_use

if TYPE_CHECKING:
    from .parallel import in_parallel as in_parallel
    from .stages import progress as progress, tracked as tracked
else:
    __all__, __dir__, __getattr__ = names_on_first_use(__name__)
