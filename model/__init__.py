"""The touch classifier: data, networks, training, export, and inference."""

import os

# From 1.29 on, ONNX Runtime for Linux keeps a database of what it runs in the home folder and sends it to its
# makers. It checks the opt-out while it is imported.
os.environ.setdefault("ORT_DISABLE_TELEMETRY", "1")
