"""Entry point of `python -m pliant.cli`, for environments without the `pliant` script."""

from pliant.cli import main

if __name__ == "__main__":
    raise SystemExit(main())
