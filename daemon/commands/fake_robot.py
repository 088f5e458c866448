"""`touchd fake-robot`: the program is among the drivers' fakes."""

from touchd.drivers.fakes.fake_robot import main as main
from touchd.drivers.fakes.fake_robot import parser as parser
