"""The folders of recordings; tests that need one are skipped when its variable is unset."""

import os

import pytest

HAART = os.environ.get("TOUCHD_HAART")
needs_haart = pytest.mark.skipif(HAART is None, reason="TOUCHD_HAART names no folder of HAART recordings")
SECOND_STUDY = os.environ.get("TOUCHD_SECOND_STUDY")
needs_second_study = pytest.mark.skipif(
    SECOND_STUDY is None, reason="TOUCHD_SECOND_STUDY names no folder of the second study's recordings"
)
THIRD_STUDY = os.environ.get("TOUCHD_THIRD_STUDY")
needs_third_study = pytest.mark.skipif(
    THIRD_STUDY is None, reason="TOUCHD_THIRD_STUDY names no folder of the third study's recordings"
)
