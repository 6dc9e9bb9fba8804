"""What pinav raises when the input, not the program, is wrong."""


class InputError(ValueError):
    """A mistake in what the user gave: one line that names it and the remedy.

    The command line prints it without a traceback and exits with code 2.
    """


class FitError(RuntimeError):
    """A fit or a rollout that failed honestly, such as one that diverged."""
