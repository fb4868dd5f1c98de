"""`python -m registry` is the command `stereogs`."""

import sys

from .cli import main

if __name__ == "__main__":
    sys.exit(main())
