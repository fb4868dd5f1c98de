"""The command `stereogs`, also as `python -m stereogs`."""

import os
import sys


def main() -> int:
    """Run the command line; verbs run with a fixed hash seed, so that sets of text always have one order.

    Python reads the seed when it starts. So the process starts again, unless the user has set a seed, in a
    debugger, or on Windows, where a process cannot be replaced.
    """
    given = sys.argv[1:]
    runs = bool(given) and not given[0].startswith("-") and not {"-h", "--help"} & {*given}
    if runs and "PYTHONHASHSEED" not in os.environ and os.name == "posix" and not sys.gettrace():
        os.environ["PYTHONHASHSEED"] = "0"
        os.execv(sys.executable, [sys.executable, *sys.orig_argv[1:]])
    from .cli import main as run

    return run()


if __name__ == "__main__":
    sys.exit(main())
