"""`python -m alula`: the command line where the console script is not on the path."""

from alula.cli import main

if __name__ == "__main__":
    main()
