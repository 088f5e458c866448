"""What every error at an edge has in common: a person can put it right."""


class TouchdError(Exception):
    """Something outside touchd is wrong: a file, a device, a setting, a network.

    The message is one line that says what is wrong, where, and what to do; the command line shows just that.
    """
