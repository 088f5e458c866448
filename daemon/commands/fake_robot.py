"""`touchd fake-robot`: the program is among the drivers' fakes."""

from touchd.drivers.fakes.fake_robot import DESCRIPTION as DESCRIPTION
from touchd.drivers.fakes.fake_robot import add_options as add_options
from touchd.drivers.fakes.fake_robot import main as main
