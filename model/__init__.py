"""The touch classifier: data, networks, training, export, and inference."""
