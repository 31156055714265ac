"""The one exception that means "the input is wrong, and here is what to do"."""


class InvalidInput(ValueError):
    """Input that cannot be used. The message says what came, what was expected and which choices exist.

    Command lines print it as one line and leave with exit code 2.
    """
