"""Optional libraries, and the command that installs them."""

import os
import shlex
import sys
from importlib import metadata

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


def extra_of(module: str) -> str | None:
    """Return the extra that installs a module, None for any other module."""
    root = module.partition(".")[0]
    return next((extra for extra, modules in EXTRAS.items() if root in modules), None)


def how_to_install(extra: str) -> str:
    """Return the shell command that installs what an extra of touchd needs into this very Python."""
    wanted = [
        requirement.partition(";")[0].strip()
        for requirement in metadata.requires("touchd") or ()
        if f'extra == "{extra}"' in requirement.replace("'", '"')
    ]
    sudo = [] if os.access(sys.prefix, os.W_OK) else ["sudo"]
    return shlex.join([*sudo, sys.executable, "-m", "pip", "install", *(wanted or EXTRAS[extra])])
