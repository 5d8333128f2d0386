"""Random numbers that depend only on what they are for: seed, sweep and purpose, never on batch size or order."""

import enum

import numpy as np


class Purpose(enum.IntEnum):
    """What a stream's numbers are for; one stream per seed, number and purpose."""

    SWEEP = 0
    EFFECT = 1
    REFERENCE = 2
    WEATHER = 3


def stream(seed: int, purpose: Purpose, number: int, extra: int = 0) -> np.random.Generator:
    """Return the generator of one purpose.

    Args:
        seed: of the scenario.
        purpose: what the numbers are for.
        number: of the sweep, or of the weather report.
        extra: tells effects of one sweep apart.
    """
    return np.random.Generator(np.random.SFC64(np.random.SeedSequence((seed, purpose, number, extra))))
