"""The calibrations that a fit on site calls for, as documents, with how far each number may still be off."""

import dataclasses
import math
from collections.abc import Sequence
from typing import Any

import numpy as np

from drfmcw_ros.calibration.document import Clock, Delay, Document, Temperatures, matrix, triangle
from drfmcw_sim.effects import Stated

from .candidates import Candidate, Pair, changed, states_delay
from .fit import Correction, SiteFit

_REFERENCE = (Stated.CLOCK, Stated.CLOCK_SLOPE)
_CLOCKS = {
    'reference_clock': ('alpha', 'alpha_linear', (_REFERENCE,)),
    'sample_clock': ('sample_clock_alpha', 'sample_clock_linear', (_REFERENCE, (Stated.SAMPLE_CLOCK,))),
}
"""Clocks of a document: value and slope in a Calibration, and what these add up from, value first; the ADC runs from
the reference."""
_GRID = 100  # temperatures at which the largest standard deviation is sought


def corrected(documents: Sequence[Document], fit: SiteFit) -> tuple[list[Document], list[Correction]]:
    """Return both stations' documents with the corrections, and the corrections that no station can hold (the air).

    What is corrected, or has stated no standard deviation so far, states what the site leaves open. Nothing changes
    where no calibration explains the site.

    Args:
        documents: of the first and the second station, which the ranges were computed with.
        fit: of the site.
    """
    if not fit.explained.any():
        return list(documents), []
    before: Pair = (documents[0].calibration(), documents[1].calibration())
    pair, foreign = before, []
    for correction in fit.corrections:
        if correction.candidate.change is None:
            foreign.append(correction)
        pair = changed(correction.candidate, pair, correction.value)
    results = []
    for i, (document, calibration) in enumerate(zip(documents, pair, strict=True)):
        clocks: dict[str, Any] = {
            section: dataclasses.replace(
                getattr(document, section), value=getattr(calibration, value), linear=getattr(calibration, linear)
            )
            for section, (value, linear, _) in _CLOCKS.items()
        }
        delay = dataclasses.replace(document.delay, value=calibration.delay, slope=calibration.delay_slope)
        new = dataclasses.replace(document, delay=delay, **clocks)
        boards = [group.board[i] for group in fit.groups]
        new = dataclasses.replace(new, temperature=_range(new, boards))
        clocks = {name: _clock(new, name, fit, i, boards) for name in _CLOCKS}
        results.append(dataclasses.replace(new, **clocks))
    return _with_delays(results, fit, states_delay(*before)), foreign


def _clock(document: Document, section: str, fit: SiteFit, station: int, boards: Sequence[float]) -> Clock:
    """Return a clock of a document with the standard deviation that the site leaves."""
    clock: Clock = getattr(document, section)
    parts = [_own(fit, station, *kinds) for kinds in _CLOCKS[section][2]]
    if clock.std and not any(c in fit.posterior.corrected for part in parts for c in part):
        return clock
    found = np.zeros((2, 2))  # of value and slope
    for part in parts:
        scale = np.array([c.scale for c in part])
        found[: len(part), : len(part)] += scale[:, None] * fit.errors(part) * scale
    covariance = _extended(matrix(clock.covariance), found)
    known = document.temperature
    low, high = (known.low, known.high) if known.high > known.low else (min(boards), max(boards))
    powers = _excess(np.linspace(low, high, _GRID), document)[:, None] ** np.arange(4)
    std = math.sqrt(np.max(np.einsum('ti,ij,tj->t', powers, covariance, powers)))
    return dataclasses.replace(clock, std=std, covariance=triangle(covariance))


def _extended(stated: np.ndarray, found: np.ndarray) -> np.ndarray:
    """Return the covariance (4, 4) of a curve whose value and slope have another one (2, 2) than stated.

    The higher orders go with them as the stated covariance says; without one they count as known.
    """
    follow = np.vstack([np.eye(2), stated[2:, :2] @ np.linalg.pinv(stated[:2, :2])])
    alone = stated - follow @ stated[:2, :2] @ follow.T
    alone[:2] = alone[:, :2] = 0.0
    covariance: np.ndarray = follow @ found @ follow.T + alone
    return covariance


def _with_delays(documents: Sequence[Document], fit: SiteFit, stated: bool) -> list[Document]:
    """Return both documents with the standard deviations of delay and slopes; ranges show the delay of the pair.

    Args:
        documents: of the first and the second station.
        fit: of the site.
        stated: whether the documents say how uncertain the delay of the pair is.
    """
    delay, slopes = _own(fit, 1, Stated.DELAY), [_own(fit, i, Stated.DELAY_SLOPE) for i in range(2)]
    own = [*delay, *slopes[0], *slopes[1]]
    errors = fit.errors(own)
    excess = np.array([_excess(np.array([g.board[i] for g in fit.groups]), d) for i, d in enumerate(documents)])
    by_number = [np.full(len(fit.groups), c.scale) * (1.0 if c in delay else excess[c.station]) for c in own]
    std = math.sqrt(np.max(np.einsum('ig,ij,jg->g', by_number, errors, by_number)))
    touched = any(c in fit.posterior.corrected for c in own)
    results = []
    for i, document in enumerate(documents):
        new: Delay = document.delay
        peer = documents[1 - i].station
        if (touched or not stated) and (i == 1 or new.peer == peer):
            new = dataclasses.replace(new, std=std, peer=peer)
        if slopes[i] and (slopes[i][0] in fit.posterior.corrected or not new.slope_std):
            (slope,) = slopes[i]
            new = dataclasses.replace(new, slope_std=slope.scale * math.sqrt(fit.errors([slope])[0, 0]))
        results.append(dataclasses.replace(document, delay=new))
    return results


def _own(fit: SiteFit, station: int, *kinds: Stated) -> list[Candidate]:
    """Return a station's numbers of some kinds, in their order."""
    return [c for kind in kinds for c in fit.posterior.offered if (c.station, c.kind) == (station, kind)]


def _excess(board: np.ndarray, document: Document) -> np.ndarray:
    """Return board temperatures [degC] over the document's reference [K]; an unknown one counts as that."""
    return np.nan_to_num(board - document.temperature.reference)


def _range(document: Document, boards: Sequence[float]) -> Temperatures:
    """Return the range of temperatures: that of the site where a curve states none."""
    known = document.temperature
    if known.high > known.low or not document.calibration().depends_on_temperature:
        return known
    low, high = min([*boards, known.reference]), max([*boards, known.reference])
    return Temperatures(known.reference, float(low), float(high))
