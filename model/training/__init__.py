"""How the shipped model is made: recordings, recipe, calibration, export, scores."""
