"""How touchd is installed: its name in commands to paste, and the commands that add optional libraries."""

import importlib.util
import json
import os
import platform
import shlex
import shutil
import sys
from collections.abc import Sequence
from contextlib import suppress
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
# The build of torch for processors alone. It is the only index for torch: if it were one of two and out of
# reach, pip would take the build on PyPI, with gigabytes of CUDA.
TORCH_ON_CPU = "https://download.pytorch.org/whl/cpu"
# On the disk, where it is worth knowing before the installation begins.
SIZES = {"train": "about 1 GB"}


# Extras with wheels for x86_64 and Python below a version alone, and what does without them.
X86_ALONE = {"ros2": ((3, 14), "use rosbridge"), "nao": ((3, 13), "leave robot.client out")}


def extra_of(module: str) -> str | None:
    """Return the extra that installs a module, None for any other module."""
    root = module.partition(".")[0]
    return next((extra for extra, modules in EXTRAS.items() if root in modules), None)


def installed() -> list[str]:
    """Return the extras that are installed."""
    return [extra for extra, modules in EXTRAS.items() if all(map(importlib.util.find_spec, modules))]


def how_to_install(extra: str) -> str:
    """Return the shell command that adds an extra, with the tool by which touchd was installed.

    Where an extra cannot be installed, say so instead.
    """
    if extra in X86_ALONE:
        below, instead = X86_ALONE[extra]
        if platform.machine() != "x86_64" or sys.version_info[:2] >= below:
            return f"it is there for x86_64 with Python below {below[0]}.{below[1]} alone; {instead}"
    here = Path(sys.prefix)
    uvs = ["--torch-backend", "cpu"] if extra == "train" else []
    if (here / "uv-receipt.toml").exists():
        # uv installs a tool as a whole: it removes extras that the command does not name.
        extras = ",".join(sorted({*installed(), extra}))
        return shlex.join(["uv", "tool", "install", *uvs, f"touchd[{extras}]{_source()}"])
    wanted = _requirements(extra)
    sudo = [] if os.access(here, os.W_OK) else ["sudo"]
    if (here / "pipx_metadata.json").exists():
        return _with_torch_alone(["pipx", "inject"], wanted, [here.name], "--pip-args=--index-url {}")
    if importlib.util.find_spec("pip") is None:
        return shlex.join([*sudo, "uv", "pip", "install", "--python", sys.executable, *uvs, *wanted])
    return _with_torch_alone([*sudo, sys.executable, "-m", "pip", "install"], wanted, [], "--index-url={}")


def _with_torch_alone(install: Sequence[str], wanted: Sequence[str], into: Sequence[str], index: str) -> str:
    """Return the command that installs requirements, torch before the others and from its own index."""
    torch = [requirement for requirement in wanted if requirement.startswith("torch")]
    others = [requirement for requirement in wanted if requirement not in torch]
    commands = [[*install, index.format(TORCH_ON_CPU), *into, *torch]] if torch else []
    return " && ".join(shlex.join(command) for command in (*commands, [*install, *into, *others]))


def _requirements(extra: str) -> Sequence[str]:
    """Return what an extra of touchd needs, as for pip."""
    # It loads a parser of mail, 1.2 MB.
    from importlib import metadata

    wanted = [
        requirement.partition(";")[0].strip()
        for requirement in metadata.requires("touchd") or ()
        if f'extra == "{extra}"' in requirement.replace("'", '"')
    ]
    return wanted or EXTRAS[extra]


def _source() -> str:
    """Return where touchd came from, as in " @ file:///home/me/touchd"; "" for a package index."""
    from importlib import metadata

    with suppress(ValueError, KeyError):
        source = json.loads(metadata.distribution("touchd").read_text("direct_url.json") or "")
        return f" @ {'git+' if 'vcs_info' in source else ''}{source['url']}"
    return ""


def program_name() -> str:
    """Return "touchd" if the shell finds this program by that name, else a path, short if it is near.

    Near is an environment in this folder, as .venv/bin/touchd: a longer relative path works here alone.
    """
    beside = Path(sys.executable).with_name(PROGRAM)
    found = shutil.which(PROGRAM)
    if found is not None and os.path.realpath(found) == os.path.realpath(beside):
        return PROGRAM
    if beside.exists():
        is_near = beside.parents[2] == Path.cwd() and beside.parents[2] != Path("/")
        return shlex.quote(str(beside.relative_to(Path.cwd()) if is_near else beside))
    return f"{shlex.quote(sys.executable)} -m touchd.daemon"


if __name__ == "__main__":
    # `make install` reads this, to keep the extras in an upgrade.
    sys.stdout.write(f"{' '.join(installed())}\n")
