"""What a site's ranges say of the calibration, in sentences."""

import math
from collections.abc import Sequence

import numpy as np

from .candidates import Kind
from .fit import Correction, SiteFit

_DECIDES = {
    Kind.DELAY: 'a second reference distance, or a cable of known length',
    Kind.CLOCK: "a frequency counter on both stations' references (calibrate station)",
    Kind.CLOCK_SLOPE: 'a frequency counter at several board temperatures, or one distance from cold to warm',
    Kind.DELAY_SLOPE: 'one distance with the boards at different temperatures, one station warmed at a time',
    Kind.SAMPLE_CLOCK: 'a frequency counter on the ADC clocks, or the same distance with another T_off',
    Kind.AIR: 'a second weather sensor, or the same distances in other weather',
}
"""Measurement that determines each, where ranges beside a reference do not."""


def sentences(fit: SiteFit, stations: Sequence[str]) -> list[str]:
    """Return what was corrected, what would do as well, what is not determined, and where the fit does not hold."""
    said = [_correction(c, stations) for c in fit.corrections]
    if not said:
        said.append('No correction: the ranges agree with the calibration within their noise.')
    for candidate, hidden in fit.undetermined:
        said.append(
            f'Not determined here: {candidate.title(stations)} (could displace ranges by {1e3 * hidden:.1f} mm beside '
            f'what is fitted). It would take {_DECIDES[candidate.kind]}.'
        )
    for i in np.flatnonzero(~fit.explained):
        group = fit.groups[i]
        said.append(
            f'Left out: {group.distance:.1f} m, off by {1e3 * fit.residual[i]:+.1f} mm after the corrections, '
            + (f'{group.doubtful} of {group.count} sweeps flagged' if group.doubtful else 'which none explains')
            + '. ./drfmcw diagnose may say why.'
        )
    return said


def _correction(found: Correction, stations: Sequence[str]) -> str:
    unit = found.candidate.unit
    digits = max(0, 1 - math.floor(math.log10(found.std)))
    text = f'{found.candidate.title(stations)}: {found.value:+.{digits}f} +- {found.std:.{digits}f} {unit}.'
    if found.rivals:
        names = ' or '.join(candidate.title(stations) for candidate in found.rivals)
        kinds = dict.fromkeys([found.candidate.kind, *(candidate.kind for candidate in found.rivals)])
        deciding = '; '.join(dict.fromkeys(_DECIDES[kind] for kind in kinds))
        text += f' The ranges alone cannot separate it from the {names}. This would: {deciding}.'
    return text


def table(fit: SiteFit, stations: Sequence[str]) -> str:
    """Return one line per group: what was off before, what is left."""
    boards = ' '.join(f'{name:>8.8}' for name in stations)
    lines = [f'{"m":>10} {boards} {"sweeps":>7} {"before":>9} {"after":>9} {"noise":>7}  (degC; mm)']
    for group, error, left, good in zip(fit.groups, fit.before, fit.residual, fit.explained, strict=True):
        board = ' '.join(f'{t:8.1f}' for t in group.board)
        lines.append(
            f'{group.distance:10.2f} {board} {group.count:7d} {1e3 * error:+9.2f} {1e3 * left:+9.2f} '
            f'{1e3 * group.std:7.2f}' + ('' if good else '   left out')
        )
    return '\n'.join(lines)
