"""The command `alula`, also as `python -m alula`."""

from alula.rooms import leave_working_directory, require_own_rooms

if __name__ == "__main__":
    leave_working_directory()
require_own_rooms()

from runtime.realtime import limit_library_threads  # noqa: E402

limit_library_threads()  # before numpy is loaded: on a busy machine threads that wait for each other take minutes

from alula.cli.app import main  # noqa: E402

__all__ = ["main"]

if __name__ == "__main__":
    main()
