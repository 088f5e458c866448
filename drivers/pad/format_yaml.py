"""A pad's description as it stands in the configuration."""

import json

import msgspec

from touchd.drivers.pad.format import PRESETS, PadFormat


def as_yaml(described: PadFormat) -> str:
    """Return a description as it stands in the configuration, on one line."""
    for name, preset in PRESETS.items():
        if preset == described:
            return f"format: {name}"
    always = {"framing": described.framing, "rows": described.rows, "columns": described.columns}
    fields = always | msgspec.to_builtins(described) | {"full_scale": described.full_scale}
    shown = {key: f"{value:g}" if key == "full_scale" else json.dumps(value) for key, value in fields.items()}
    return f"format: {{{', '.join(f'{key}: {value}' for key, value in shown.items())}}}"
