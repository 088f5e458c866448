"""`touchd fake-robot`: see `touchd.drivers.fakes.fake_robot`."""

from touchd.drivers.fakes.fake_robot import DESCRIPTION as DESCRIPTION
from touchd.drivers.fakes.fake_robot import add_options as add_options
from touchd.drivers.fakes.fake_robot import main as main
