"""`touchd fake-robot`, whose program drivers need too."""

from touchd.drivers.fakes.fake_robot import main as main
from touchd.drivers.fakes.fake_robot import parser as parser
