"""The errors that a user can cause, each with the exit code that the command line ends with.

A message names the input, what is wrong with it and what to do next.
"""


class AlulaError(Exception):
    """An error with an exit code, shown without a traceback."""

    exit_code = 1


class RequestError(AlulaError):
    """A wrong request: a file, an option, a vehicle that cannot exist."""

    exit_code = 2


class DataError(AlulaError):
    """The data cannot answer the request."""

    exit_code = 3


class VehicleError(AlulaError):
    """The vehicle or the link refused."""

    exit_code = 4
