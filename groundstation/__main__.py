"""Lets `python -m groundstation` run the same program as the console script."""

from groundstation.cli import main

main()
