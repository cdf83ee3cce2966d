"""Regenerates `oneway.py` from `oneway.xml`: `python -m companion.dialect [FOLDER]`.

The generator and minimal.xml, which the dialect includes, come from the installed pymavlink.
"""

from __future__ import annotations

import contextlib
import io
import shutil
import sys
import tempfile
from pathlib import Path

import pymavlink.dialects.v20
from pymavlink.generator import mavgen, mavparse

FOLDER = Path(__file__).parent


def generate(folder: Path) -> Path:
    """Write `oneway.py` into a folder and return its path."""
    target = folder / "oneway.py"
    included = Path(pymavlink.dialects.v20.__path__[0]) / "minimal.xml"
    with tempfile.TemporaryDirectory() as scratch:
        # mavgen resolves includes beside the XML, and names the dialect after the output file.
        for source in (FOLDER / "oneway.xml", included):
            shutil.copy(source, scratch)
        options = mavgen.Opts(
            str(target.with_suffix("")), wire_protocol=mavparse.PROTOCOL_2_0, language="Python3", validate=False
        )
        with contextlib.redirect_stdout(io.StringIO()):
            if not mavgen.mavgen(options, [str(Path(scratch) / "oneway.xml")]):
                raise RuntimeError("mavgen refused oneway.xml")
    return target


if __name__ == "__main__":
    print(generate(Path(sys.argv[1]) if len(sys.argv) > 1 else FOLDER))
