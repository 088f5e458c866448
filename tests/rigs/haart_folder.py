"""The folder of HAART recordings, where there is one: TOUCHD_HAART names it; without it tests are skipped."""

from __future__ import annotations

import os

import pytest

HAART = os.environ.get("TOUCHD_HAART")
needs_haart = pytest.mark.skipif(HAART is None, reason="TOUCHD_HAART names no folder of HAART recordings")
