"""The short way to the built-in tasks' pictures: ``python -m dead_ends.visualize brake``."""

from dead_ends.cli.visualize import main

__all__ = ["main"]

if __name__ == "__main__":
    raise SystemExit(main())
