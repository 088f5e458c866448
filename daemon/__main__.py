"""`python -m daemon` is `touchd`, wherever the command itself is not on the PATH."""

import sys

from daemon.cli import main

sys.exit(main())
