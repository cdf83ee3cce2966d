"""Lets `python -m sim` run the same program as the console script."""

from sim.cli import main

main()
