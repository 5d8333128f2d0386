"""What each figure of the paper gives: points to simulate, then a plot, text and claims."""

import dataclasses
from collections.abc import Callable, Sequence

import numpy as np
from matplotlib.figure import Figure

from .claims import Claim, millimetres
from .experiments import Outcome, Point, Prediction, Run

LABORATORY_PATH = 15.0
"""Length of air that delays as the laboratory's cables do; the paper does not give it [m]."""

LABORATORY_DELAY = 4e-6
"""T_off of the laboratory measurements [s]."""

CHANCE = 5.0
"""Standard errors up to which a difference counts as chance: in one run of 10 000, one of 100 values exceeds it."""

NOMINAL = (1.0, 1.0)
"""Reference oscillators that are exact."""

NO_DELAY = {'delay': 0.0}
"""Of a station's hardware: the path given is the whole one."""


@dataclasses.dataclass(frozen=True)
class Finished:
    """What a section shows."""

    figure: Figure
    text: str  # paragraph below the plot
    claims: tuple[Claim, ...] = ()
    table: str = ''  # in Markdown


@dataclasses.dataclass(frozen=True)
class Section:
    """One figure of the paper."""

    name: str  # fig6 ... fig12
    title: str
    points: tuple[Point, ...]
    finish: Callable[[Sequence[Outcome], Run], Finished]


def column(outcomes: Sequence[Outcome] | Sequence[Prediction], field: str) -> np.ndarray:
    """Return one field of all."""
    return np.array([getattr(o, field) for o in outcomes])


def worst(bias: np.ndarray, error: np.ndarray) -> str:
    """Return the largest bias [m] in words, beside its standard error [m]."""
    return f'largest {millimetres(np.abs(bias).max(), 2)}, {np.max(np.abs(bias) / error):.1f} standard errors'
