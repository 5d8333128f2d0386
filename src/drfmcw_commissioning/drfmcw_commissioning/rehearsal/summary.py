"""What many rehearsed commissionings show, distance by distance."""

import dataclasses
import math
from collections.abc import Iterable, Sequence

import numpy as np

from .commissioning import Outcome

LIMIT = 1.5e-3
"""Bias that a commissioned pair may have beyond its stated uncertainty [m] (issue 15)."""
CHI_SQUARE_LIMIT = 0.2
"""Deviation of the mean chi-square from 1 that it may have (issue 15)."""
FEWEST = 200
"""Commissionings from which on the mean chi-square is judged: its standard deviation is 0.1 then."""


@dataclasses.dataclass(frozen=True)
class Row:
    """Commissionings at one distance."""

    distance: float  # [m]
    count: int
    mean: float  # of the errors [m]
    rms: float  # of the errors [m]
    stated: float  # root mean square of the stated standard deviations [m]
    chi_square: float  # mean square of error over stated standard deviation, 1 if what is stated holds
    within: float  # share of errors within LIMIT and two stated standard deviations
    rms_without_curve: float  # of the errors with the same calibrations less their curves over the temperature [m]
    flagged: int  # commissionings with a flagged range

    @property
    def systematic(self) -> bool:
        """Whether the mean error exceeds LIMIT by three of its standard deviations."""
        return abs(self.mean) > LIMIT + 3.0 * self.stated / math.sqrt(self.count)

    @property
    def holds(self) -> bool:
        """Whether what the calibrations state holds: no bias, and errors as large as stated."""
        as_stated = self.count < FEWEST or abs(self.chi_square - 1.0) <= CHI_SQUARE_LIMIT
        return as_stated and not self.systematic


def summarise(commissionings: Iterable[Sequence[Outcome]]) -> list[Row]:
    """Return one row per distance."""
    rows = []
    for outcomes in zip(*commissionings, strict=True):
        error, stated, flat = (
            np.array([getattr(o, name) for o in outcomes]) for name in ('error', 'stated', 'without_curve')
        )
        rows.append(
            Row(
                distance=outcomes[0].distance,
                count=len(outcomes),
                mean=float(np.mean(error)),
                rms=float(np.sqrt(np.mean(error**2))),
                stated=float(np.sqrt(np.mean(stated**2))),
                chi_square=float(np.mean((error / stated) ** 2)),
                within=float(np.mean(np.abs(error) <= LIMIT + 2.0 * stated)),
                rms_without_curve=float(np.sqrt(np.mean(flat**2))),
                flagged=sum(bool(o.flags) for o in outcomes),
            )
        )
    return rows


def table(rows: Sequence[Row]) -> str:
    """Return the rows as a Markdown table, in millimetres."""
    lines = [
        '| distance [m] | commissionings | mean error [mm] | rms error [mm] | stated [mm] | mean chi-square '
        '| within 1.5 mm + 2 stated | flagged | rms without curve [mm] |',
        '| -: | -: | -: | -: | -: | -: | -: | -: | -: |',
    ]
    lines += [
        f'| {r.distance:g} | {r.count} | {r.mean * 1e3:+.2f} | {r.rms * 1e3:.2f} | {r.stated * 1e3:.2f} '
        f'| {r.chi_square:.2f} | {r.within:.1%} | {r.flagged} | {r.rms_without_curve * 1e3:.2f} |'
        for r in rows
    ]
    return '\n'.join(lines)
