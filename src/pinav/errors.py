"""What pinav raises when the input, not the program, is wrong."""


class InputError(ValueError):
    """A mistake in what the user gave: one line that names it and the remedy.

    The command line prints it without a traceback and exits with code 2.
    """


class FitError(RuntimeError):
    """A fit or a rollout that failed honestly, such as one that diverged.

    Attributes:
        outcome: the word for how a fit ended, as `str(Outcome)` gives it; empty where
            it did not begin. The remedy depends on who asks: the message names
            arguments of the library, a command names its own options.
    """

    def __init__(self, message: str, outcome: str = "") -> None:
        RuntimeError.__init__(self, message)
        self.outcome = outcome
