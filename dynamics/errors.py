"""The errors that a user can cause, each with the exit code that the command line ends with.

Messages say what was given, what was wanted and what to do next.
"""


class AlulaError(Exception):
    """An error with an exit code, shown without a traceback."""

    exit_code = 1


class RequestError(AlulaError):
    """What was asked for is wrong: a file, an option, a vehicle that cannot exist."""

    exit_code = 2


class DataError(AlulaError):
    """The data cannot answer what was asked."""

    exit_code = 3


class VehicleError(AlulaError):
    """The vehicle or the link refused."""

    exit_code = 4
