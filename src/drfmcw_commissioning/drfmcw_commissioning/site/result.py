"""The calibrations that a fit on site calls for, as documents."""

import dataclasses
from collections.abc import Sequence

import numpy as np

from drfmcw_ros.calibration.document import Document, Temperatures

from .candidates import Kind, Pair, changed
from .fit import Correction, SiteFit

_SPEC = {'alpha': 'reference_clock', 'sample_clock': 'sample_clock'}


def corrected(documents: Sequence[Document], fit: SiteFit) -> tuple[list[Document], list[Correction]]:
    """Return both stations' documents with the corrections, and the corrections that no station can hold (the air).

    Args:
        documents: of the first and the second station, which the ranges were computed with.
        fit: of the site.
    """
    before: Pair = (documents[0].calibration(), documents[1].calibration())
    pair, foreign = before, []
    for correction in fit.corrections:
        if correction.candidate.change is None:
            foreign.append(correction)
        pair = changed(correction.candidate, pair, correction.value)
    results = []
    for i, (document, calibration) in enumerate(zip(documents, pair, strict=True)):
        own = [c for c in fit.corrections if c.candidate.station == i]
        clocks = {}
        for name, section in _SPEC.items():
            clock = getattr(document, section)
            clocks[section] = dataclasses.replace(
                clock,
                value=calibration.alpha if name == 'alpha' else calibration.sample_clock_alpha,
                linear=getattr(calibration, f'{name}_linear'),
                std=_std(clock.std, own, (Kind.CLOCK, Kind.SAMPLE_CLOCK) if name != 'alpha' else (Kind.CLOCK,)),
                covariance=[] if own else clock.covariance,
            )
        delay = dataclasses.replace(
            document.delay,
            value=calibration.delay,
            slope=calibration.delay_slope,
            std=_std(document.delay.std, own, (Kind.DELAY,)),
            peer=documents[1 - i].station if any(c.candidate.kind == Kind.DELAY for c in own) else document.delay.peer,
        )
        new = dataclasses.replace(document, delay=delay, **clocks)
        results.append(dataclasses.replace(new, temperature=_range(new, [g.board[i] for g in fit.groups])))
    return results, foreign


def _std(stated: float, own: Sequence[Correction], kinds: Sequence[Kind]) -> float:
    """Return the standard deviation of a value: that of its correction where it has one."""
    fitted = [c.std * c.candidate.scale for c in own if c.candidate.kind in kinds]
    return float(np.sqrt(np.sum(np.square(fitted)))) if fitted else stated


def _range(document: Document, boards: Sequence[float]) -> Temperatures:
    """Return the range of temperatures: that of the site where a curve states none."""
    known = document.temperature
    if known.high > known.low or not document.calibration().depends_on_temperature:
        return known
    low, high = min([*boards, known.reference]), max([*boards, known.reference])
    return Temperatures(known.reference, float(low), float(high))
