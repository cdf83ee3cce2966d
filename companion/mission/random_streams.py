"""A seed's independent random streams: what one part of a program draws changes nothing for another."""

from __future__ import annotations

import numpy as np


def random_stream(seed: int, *stream: int) -> np.random.Generator:
    """Return the generator of one of a seed's independent streams."""
    return np.random.Generator(np.random.PCG64(np.random.SeedSequence([seed, *stream])))
