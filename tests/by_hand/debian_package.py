"""The Debian package under a real dpkg and systemd: built, installed, upgraded, removed, purged.

    python -m pytest -n 0 -s tests/by_hand/debian_package.py       needs root and systemd-container

Runs in the container of real_systemd.py. It takes too long for the suite; its file name keeps it out.
"""

from collections.abc import Iterator

import pytest
from by_hand.debian_container import WHY_NOT, Container, booted

BUILD = "cd /root/touchd && PIP_NO_INDEX=1 PIP_FIND_LINKS=/mnt/wheels make deb"
CONFIGURATION = "sensor: {port: /dev/not-there}\n"
OF_THE_HEAD = "sensor: {port: /dev/not-there-either}\njournal: {}\n"
FILES = "find / -xdev -path /root -prune -o -path /proc -prune -o -name '*touchd*' -print | sort"

pytestmark = [
    pytest.mark.timeout(1800),
    pytest.mark.skipif(bool(WHY_NOT), reason=WHY_NOT),
]


@pytest.fixture(scope="module")
def lab() -> Iterator[Container]:
    with booted() as machine:
        machine.run("cp -r /mnt/touchd /root/touchd")
        yield machine


def test_a_package_is_built_installed_upgraded_removed_and_purged(lab: Container) -> None:
    before = lab.run(FILES)
    lab.run(BUILD, 1500)
    package = lab.run("ls /root/touchd/dist/*.deb")
    lab.run(f"dpkg -i {package}", 300)
    assert lab.run("touchd --version") == "touchd 0.1.0"
    assert lab.run("stat -c '%U %G %a' /etc/touchd/touchd.yaml") == "root touchd 640"
    assert not lab.succeeds("systemctl is-active -q touchd")

    lab.write("/etc/touchd/touchd.yaml", CONFIGURATION)
    lab.run("systemctl enable --now --quiet touchd", 300)
    lab.write("/etc/touchd/head.yaml", OF_THE_HEAD)
    lab.run("systemctl enable --now --quiet touchd@head", 300)
    services = ("touchd", "touchd@head")
    processes = [lab.run(f"systemctl show {service} -P MainPID") for service in services]
    assert lab.run("wc -l < /var/lib/touchd/head/events.jsonl") == "1"
    lab.run("cd /root/touchd && sed -i 's/^version = .*/version = \"0.1.1\"/' pyproject.toml")
    lab.run(BUILD, 1500)
    lab.run("dpkg -i /root/touchd/dist/touchd_0.1.1_*.deb", 300)
    assert lab.run("touchd --version") == "touchd 0.1.1"
    assert lab.run("cat /etc/touchd/touchd.yaml") == CONFIGURATION.strip()
    for service, process in zip(services, processes, strict=True):
        lab.wait_until(f"systemctl is-active -q {service}")
        assert lab.run(f"systemctl show {service} -P MainPID") != process

    lab.run("dpkg -r touchd", 300)
    for service in services:
        assert not lab.succeeds(f"systemctl is-active -q {service}")
        assert not lab.succeeds(f"systemctl is-enabled -q {service}")
    assert lab.run("ls /etc/touchd") == "head.yaml\ntouchd.yaml"
    assert not lab.succeeds("command -v touchd")
    lab.run("dpkg -P touchd", 300)
    left = set(lab.run(FILES).splitlines()) - set(before.splitlines())
    assert {path for path in left if not path.startswith("/var/lib/systemd")} == set()


def test_a_package_refuses_a_machine_with_make_install(lab: Container) -> None:
    lab.run("touch /etc/systemd/system/touchd.service")
    assert not lab.succeeds("dpkg -i /root/touchd/dist/touchd_0.1.1_*.deb")
    lab.run("rm /etc/systemd/system/touchd.service; dpkg -P touchd; true")
