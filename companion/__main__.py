"""Lets `python -m companion` run the same program as the console script."""

from companion.cli import main

main()
