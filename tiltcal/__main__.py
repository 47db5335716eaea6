"""``python -m tiltcal``."""

import os
import sys

if not sys.flags.safe_path and sys.path[:1] in ([""], [os.getcwd()]):  # noqa: PTH109  before any other import
    del sys.path[0]  # Python's own doing: a file there could take the place of a package

from tiltcal.cli import main

sys.exit(main())
