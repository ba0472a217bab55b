"""The command `alula`, also as `python -m alula`."""

from runtime.realtime import limit_library_threads

limit_library_threads()  # before numpy is loaded: on a busy machine threads that wait for each other take minutes

from alula.cli.app import main  # noqa: E402

__all__ = ["main"]

if __name__ == "__main__":
    main()
