"""`python -m touchd.daemon` is `touchd`, wherever the command itself is not on the PATH."""

import sys

from touchd.daemon.cli import main

sys.exit(main())
