"""`python -m stereogs` is the command `stereogs`."""

import sys

from registry.__main__ import main

if __name__ == "__main__":
    sys.exit(main())
