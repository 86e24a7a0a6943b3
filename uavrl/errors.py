"""The one exception that the command line turns into one sentence."""


class UavrlError(ValueError):
    """A mistake that the user can mend: what was expected, what came, and what to do."""
