"""`python -m bayesdrill`."""

from bayesdrill.cli import main

if __name__ == "__main__":
    main()
