"""What a site's sweeps say of the calibration, in sentences."""

import itertools
import math
from collections.abc import Sequence

import numpy as np

from drfmcw_diagnosis.finding.limits import SEPARATION
from drfmcw_diagnosis.finding.quantities import scaled

from .fit import SiteFit
from .separability import Rival, Separability, Size

_LISTED = 8  # rivals
_DIAGNOSE = './drfmcw diagnose may say why.'


def sentences(fit: SiteFit, apart: Separability | None, stations: Sequence[str]) -> list[str]:
    """Return what was corrected, what would do as well, what is not determined, and where the fit does not hold."""
    if apart is None:
        return [f'No correction: no calibration explains two thirds of these groups. {_DIAGNOSE}']
    said = [
        _correction(Size(c.candidate.title(stations), c.value, c.std, c.candidate.unit), seen)
        for c, seen in itertools.zip_longest(fit.corrections, apart.by_samples)
    ]
    if not said:
        said.append('No correction: the ranges agree with the calibration within their noise.')
    said += _separated(apart)
    for hidden, shown in zip(fit.undetermined, apart.showing, strict=True):
        nothing = f'None of {apart.simulated} simulated measurements would show it.'
        said.append(
            f'Not determined here: {hidden.candidate.title(stations)} (could displace ranges by '
            f'{1e3 * hidden.displacement:.1f} mm beside what is fitted). '
            + (f'This would show it: {shown.sentence}' if shown else nothing)
        )
    for i in np.flatnonzero(~fit.explained):
        group = fit.groups[i]
        said.append(
            f'Left out: {group.distance:.1f} m, off by {1e3 * fit.residual[i]:+.1f} mm after the corrections, '
            + (f'{group.doubtful} of {group.count} sweeps flagged' if group.doubtful else 'which none explains')
            + f'. {_DIAGNOSE}'
        )
    return said


def _correction(found: Size, by_samples: Size | None) -> str:
    text = f'{found.title}: {_quantity(found)}'
    if by_samples is None:
        return f'{text}.'
    text += f' (the samples alone: {_quantity(by_samples)}).'
    if abs(found.value - by_samples.value) > SEPARATION.separable * math.hypot(found.std, by_samples.std):
        text += ' They do not agree: something else is in the samples. ./drfmcw diagnose may say what.'
    return text


def _separated(apart: Separability) -> list[str]:
    """Return what fits as well as the corrections, and what would decide."""
    said = []
    if apart.rivals:
        listed = '; '.join(f'{_explanation(r)} ({r.distance:.1f})' for r in apart.rivals[:_LISTED])
        more = len(apart.rivals) - _LISTED
        said.append(
            f'The sweeps cannot separate this from: {listed}{f"; {more} more" if more > 0 else ""}. '
            f'In brackets: standard deviations apart; {SEPARATION.separable:g} are needed.'
        )
    said += [f'Decisive measurement: {measurement.sentence}' for measurement in apart.deciding]
    ruled_out = frozenset().union(*(m.ruled_out for m in apart.deciding))
    left = [rival for i, rival in enumerate(apart.rivals) if i not in ruled_out]
    if left:
        others = '; '.join(_explanation(rival) for rival in left[:_LISTED])
        said.append(f'None of {apart.simulated} simulated measurements would rule out: {others}.')
    return said


def _explanation(rival: Rival) -> str:
    return ' and '.join(f'{size.title} {_quantity(size)}' for size in rival.sizes)


def _quantity(size: Size) -> str:
    factor, unit = scaled(max(abs(size.value), size.std), size.unit)
    digits = max(0, 1 - math.floor(math.log10(size.std * factor)))
    return f'{size.value * factor:+.{digits}f} +- {size.std * factor:.{digits}f} {unit}'


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
