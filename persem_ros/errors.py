"""The one exception that a user meets: what was wrong, what was expected, what to type."""


class PersemError(Exception):
    """
    A refusal in one sentence, fit to be shown to a user as it is.

    The command line prints it as one line and exits with status 1; the node logs it.

    """
