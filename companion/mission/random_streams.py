"""Independent random streams of one seed: the draws of one part of a program change nothing for another part."""

from __future__ import annotations

import numpy as np


def random_stream(seed: int, *stream: int) -> np.random.Generator:
    """Return a new generator at the start of the stream that these numbers name; other numbers name other streams."""
    return np.random.Generator(np.random.PCG64(np.random.SeedSequence([seed, *stream])))
