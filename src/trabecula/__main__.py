"""`python -m trabecula`: the command line, also where its script is not on the path."""

import sys

from trabecula.cli.main import main

if __name__ == "__main__":
    sys.exit(main())
