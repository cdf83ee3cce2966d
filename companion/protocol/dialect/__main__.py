"""Regenerates `oneway.py` and `oneway.lua` from `oneway.xml`: `python -m companion.protocol.dialect [FOLDER]`.

The first is for programs in Python, the second for Wireshark and tshark. The generator and minimal.xml, which the
dialect includes, come from the installed pymavlink.
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
LANGUAGES = {"oneway.py": "Python3", "oneway.lua": "WLua"}
"""Name of each generated file, and the generator's name of its language."""


def generate(folder: Path) -> list[Path]:
    """Write the generated files into a folder and return their paths.

    Raises:
        RuntimeError: the generator refused the XML.

    """
    return [_generate(folder / name, language) for name, language in LANGUAGES.items()]


def _generate(target: Path, language: str) -> Path:
    included = Path(pymavlink.dialects.v20.__path__[0]) / "minimal.xml"
    with tempfile.TemporaryDirectory() as scratch:
        # mavgen resolves includes beside the XML, and names the dialect after the output file.
        for source in (FOLDER / "oneway.xml", included):
            shutil.copy(source, scratch)
        options = mavgen.Opts(
            str(target.with_suffix("")), wire_protocol=mavparse.PROTOCOL_2_0, language=language, validate=False
        )
        with contextlib.redirect_stdout(io.StringIO()):
            if not mavgen.mavgen(options, [str(Path(scratch) / "oneway.xml")]):
                raise RuntimeError("mavgen refused oneway.xml")
    return target


if __name__ == "__main__":
    for path in generate(Path(sys.argv[1]) if len(sys.argv) > 1 else FOLDER):
        print(path)
