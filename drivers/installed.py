"""How touchd is installed: its name in commands to paste, and the commands that add optional libraries."""

import importlib.util
import os
import platform
import shlex
import shutil
import sys
from collections.abc import Sequence
from pathlib import Path

PROGRAM = "touchd"

EXTRAS = {
    "plot": ("matplotlib",),
    "live": ("websockets", "segno"),
    "nao": ("qi",),
    "mqtt": ("paho",),
    "lsl": ("pylsl",),
    "ros2": ("cyclonedds",),
    "rosbridge": ("websockets",),
    "mcap": ("mcap",),
    "train": ("torch", "onnx", "scipy", "tqdm"),
    "studies": ("onnxscript", "sklearn", "mlxtend"),
}
# The index of torch's build without CUDA. It is the only index for torch: if it were one of two and could not
# be reached, pip would install the build on PyPI, with gigabytes of CUDA.
TORCH_ON_CPU = "https://download.pytorch.org/whl/cpu"
# Sizes on the disk that are worth knowing before the installation.
SIZES = {"train": "about 1 GB"}
# Extras that only have wheels for x86_64 and Python below a version, and the alternative without them.
X86_ALONE = {"ros2": ((3, 14), "use rosbridge"), "nao": ((3, 13), "leave robot.client out")}


def extra_of(module: str) -> str | None:
    """Return the extra that installs a module, None for any other module."""
    root = module.partition(".")[0]
    return next((extra for extra, modules in EXTRAS.items() if root in modules), None)


def how_to_install(extra: str) -> str:
    """Return the shell command that adds an extra to touchd's own Python, or why there is none."""
    if extra in X86_ALONE:
        below, instead = X86_ALONE[extra]
        if platform.machine() != "x86_64" or sys.version_info[:2] >= below:
            return f"it is there for x86_64 with Python below {below[0]}.{below[1]} alone; {instead}"
    install = [sys.executable, "-m", "pip", "install"]
    if importlib.util.find_spec("pip") is None:
        # uv makes environments without pip.
        install = ["uv", "pip", "install", f"--python={sys.executable}"]
    if not os.access(sys.prefix, os.W_OK):
        install = ["sudo", *install]
    wanted = _requirements(extra)
    torch = [requirement for requirement in wanted if requirement.startswith("torch")]
    others = [requirement for requirement in wanted if requirement not in torch]
    commands = [[*install, f"--index-url={TORCH_ON_CPU}", *torch]] if torch else []
    return " && ".join(map(shlex.join, [*commands, [*install, *others]]))


def _requirements(extra: str) -> Sequence[str]:
    """Return what an extra of touchd needs, as for pip."""
    # It imports an e-mail parser of 1.2 MB.
    from importlib import metadata

    wanted = [
        requirement.partition(";")[0].strip()
        for requirement in metadata.requires("touchd") or ()
        if f'extra == "{extra}"' in requirement.replace("'", '"')
    ]
    return wanted or EXTRAS[extra]


def program_name() -> str:
    """Return "touchd" if the shell finds this program by that name, else its path."""
    beside = Path(sys.executable).with_name(PROGRAM)
    found = shutil.which(PROGRAM)
    if found is not None and os.path.realpath(found) == os.path.realpath(beside):
        return PROGRAM
    if beside.exists():
        return shlex.quote(str(beside))
    return f"{shlex.quote(sys.executable)} -m touchd.daemon"


if __name__ == "__main__":
    # `make install` reads which extras are installed, to keep them in an upgrade.
    found = (extra for extra, modules in EXTRAS.items() if all(map(importlib.util.find_spec, modules)))
    sys.stdout.write(f"{' '.join(found)}\n")
