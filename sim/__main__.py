"""Makes `python -m sim` run the same program as the console script `sim`."""

from sim.cli import main

main()
