"""The errors a user can act on, and the exit code each one gives."""

INTERRUPTED = 130
"""Exit code of a verb that Ctrl-C, the experimenter or Escape ended."""


class SetupError(Exception):
    """The user's or the set-up's mistake: say what was expected, what was found, what to do."""

    exit_code = 2


class LinkLost(Exception):
    """A stream or a process that a running session needs is gone."""

    exit_code = 3
