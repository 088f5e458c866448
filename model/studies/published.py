"""Accuracies that the paper prints (Ren, Hou and Belpaeme, HRI 2023), in percent."""

TABLE3 = {9: 57.0, 27: 66.6, 54: 70.8, 72: 71.1, 108: 72.3, 144: 72.8, 216: 71.6}
"""By frames, with six blocks. The paper's 1.5 s are 72 frames, that is 1.33 s; it has no row for 81."""
