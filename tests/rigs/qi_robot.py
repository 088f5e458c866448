"""The stand-in robot on the robot's own library, qi, instead of our server."""

import os
import sys
from collections.abc import Mapping

from touchd.drivers.fakes import fake_robot
from touchd.drivers.robot.qi_session import load_qi


class RealServer:
    """Serves objects with qi."""

    def __init__(self, services: Mapping[str, object], port: int) -> None:
        qi = load_qi()
        self._session = qi.Session()
        self._session.listenStandalone(f"tcp://127.0.0.1:{port}")
        self.url: str = self._session.endpoints()[0]
        for name, service in services.items():
            # In a single thread, speech would block every other call.
            qi.multiThreaded()(type(service))
            self._session.registerService(name, service)

    def close(self) -> None:
        self._session.close()
        sys.stdout.flush()
        # libqi's threads may still be releasing our services. If Python ends during that, it aborts.
        os._exit(0)


if __name__ == "__main__":
    fake_robot.QiServer = RealServer  # type: ignore[assignment,misc]
    fake_robot.program()
