"""The study behind `touchd report`: the paper's tables beside ours, one part a module."""
