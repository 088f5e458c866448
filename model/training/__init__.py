"""From recordings to the shipped files: data, augmentation, training, calibration, export."""
