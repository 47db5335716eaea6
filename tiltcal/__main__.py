"""``python -m tiltcal``."""

import sys

from tiltcal.cli import main

sys.exit(main())
