"""The error that users cause and can mend."""


class InputError(ValueError):
    """Bad input: names the value and the way out. The command line prints it and exits with 2."""
