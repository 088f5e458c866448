"""The first configuration: found by listening, and good to run as it is."""

from __future__ import annotations

from pathlib import Path

import pytest
from rigs.expectations import RECORDINGS, stream_of

from daemon.commands.init import main
from daemon.config import ConfigError, SensorSettings, load
from daemon.setup.destinations import encoder_for
from drivers.fakes.fake_port import FakePort

STREAM = stream_of(next(iter(RECORDINGS)))


def test_a_pad_is_found_and_written_down_as_it_is(tmp_path: Path) -> None:
    path = tmp_path / "touchd.yaml"
    sensor = SensorSettings()
    with FakePort(STREAM, encoder_for(sensor), speed=4.0, loop=True) as port:
        assert main([str(path), "--port", port.path, "--baud", "115200", "--robot", "none"]) == 0
    settings = load(path)
    assert settings.sensor.described == sensor.described
    assert (settings.sensor.port, settings.sensor.baud) == (port.path, 115200)
    assert settings.robot is None
    assert settings.journal is not None
    with pytest.raises(ConfigError, match="is there already"):
        main([str(path)])


def test_without_a_pad_the_file_is_written_all_the_same(tmp_path: Path) -> None:
    path = tmp_path / "touchd.yaml"
    assert main([str(path), "--port", str(tmp_path / "none"), "--baud", "115200", "--robot", "none"]) == 1
    assert load(path).sensor.described == SensorSettings().described
