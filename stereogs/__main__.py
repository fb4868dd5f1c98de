"""`python -m stereogs` is the command `stereogs`."""

import sys

from registry.cli import main

if __name__ == "__main__":
    sys.exit(main())
