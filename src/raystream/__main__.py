"""``python -m raystream``: the command line."""

from raystream.cli import main

if __name__ == "__main__":
    main()
