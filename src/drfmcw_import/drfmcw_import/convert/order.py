"""Whether samples and sweeps lie as the layout says: a wrong order repeats, jumps or goes on where it should not.

Three things give a wrong layout away. Sources that take turns sample by sample make steps of a size that repeats with
their number. Blocks read as one sweep make jumps at their borders. Sweeps cut too short go on into the next one, which
a linear prediction of the samples shows.
"""

import numpy as np

from ..formats.base import Numbers
from .finding import Finding
from .spectra import averaged_spectrum, near_zero, strongest

_SOURCES = (2, 3, 4, 6, 8)
_BLOCKS = (8, 4, 3, 2)
_FEWEST = 8  # samples of each source, and of each block, that determine anything
_SPREAD, _SURE = 0.6, 8.0  # of the logarithms of the sources' steps, and over its standard deviation: they take turns
_MIRRORED = 10.0**-0.6  # of a line's power that its image has where sources alternate
_JUMP = 5.0  # times the usual jump over the steps around it: a border
_ALONE = 1.5  # times these steps that a jump at a border has at least
_RARE = 0.03  # share of all instants that may jump as much as a border
_RAIL = 0.01  # of the used range: samples so near its ends are limited, and their steps say nothing
_AROUND = 4  # steps that a jump is compared with
_ORDER = 8  # of the linear prediction
_GOES_ON, _BEGINS = 4.0, 16.0  # times the usual square error of the prediction at the start of a sweep
_PREDICTED = 30.0  # times the square error that the power has at least where all sweeps go on
_BORDERS = 4  # between sweeps that determine anything
_ROWS = 512  # sweeps looked at


def order_findings(signal: Numbers) -> list[Finding]:
    """Return what (n, N) real or complex sweeps say about the layout; samples that never change say nothing."""
    if not np.diff(signal, axis=1).any():
        return []
    found = [alternating(signal), bordered(signal)]
    return found if not all(f.agrees for f in found) else [*found, *cut_short(signal)]


def alternating(signal: Numbers) -> Finding:
    """Say whether sources alternate sample by sample."""
    count = _sources(signal) or _mirrored(averaged_spectrum(signal), bool(np.iscomplexobj(signal)))
    if not count:
        return Finding(True, 'no signs of sources that alternate sample by sample')
    return Finding(
        False,
        f'the signal repeats with every {count} samples: {count} sources alternate sample by sample: put receiver or '
        f'iq as an axis of size {count} behind sample',
    )


def _sources(signal: Numbers) -> int:
    """Return the number of sources by the sizes of their steps, which repeat with it; 0 for one source."""
    rest = _without_line(signal)
    step = np.mean(np.abs(np.diff(rest, axis=1)) ** 2, axis=0)
    found = {}
    for sources in _SOURCES:
        groups = len(step) // sources
        if groups < _FEWEST:
            continue
        log = np.log(step[: groups * sources] + 1e-3 * np.median(step) + 1e-12).reshape(groups, sources)
        log = log - log.mean(axis=1, keepdims=True)
        usual = np.median(log, axis=0)
        doubt = 1.25 * np.std(log, axis=0) / np.sqrt(groups)  # of a median
        spread = float(np.ptp(usual))
        if spread > max(_SPREAD, _SURE * float(np.hypot(doubt[usual.argmin()], doubt[usual.argmax()]))):
            found[sources] = spread
    return next((n for n, spread in found.items() if spread > 0.8 * max(found.values())), 0)


def _without_line(signal: Numbers) -> Numbers:
    """Return sweeps less their strongest line: one of a simple fraction of the sampling rate repeats by itself."""
    count, iq = signal.shape[1], bool(np.iscomplexobj(signal))
    spectrum = averaged_spectrum(signal)
    at = strongest(spectrum, iq)
    left, middle, right = np.log(np.maximum(spectrum[[at - 1, at, (at + 1) % count]], 1e-300))
    bend = left - 2.0 * middle + right
    turn = np.exp(2j * np.pi * (at + (0.5 * (left - right) / bend if bend < 0.0 else 0.0)) / count * np.arange(count))
    turns = turn[:, None] * np.linspace(-1.0, 1.0, count)[:, None] ** np.arange(3)  # its frequency is not known exactly
    base, _ = np.linalg.qr(
        np.hstack([np.ones((count, 1)), turns] if iq else [np.ones((count, 1)), turns.real, turns.imag])
    )
    return np.asarray(signal - (signal @ base.conj()) @ base.T)


def _mirrored(spectrum: Numbers, iq: bool) -> int:
    """Return how many sources images of the strongest line show, at multiples of 1 / p of the sampling rate, else 0."""
    count = len(spectrum)
    guard = near_zero(count)
    floor = float(np.median(spectrum))
    line = strongest(spectrum, iq)
    if spectrum[line] < 30.0 * floor:
        return 0
    for sources in reversed(_SOURCES):
        if count % sources:
            continue
        images = [(line + count * m // sources) % count for m in range(1, sources)]
        apart = [min(abs(i - j) % count for j in (line, count - line)) > 2 * guard for i in images]
        strengths = [max(spectrum[(i + d) % count] for d in (-1, 0, 1)) for i in images]
        if all(apart) and min(strengths) > max(10.0 * floor, _MIRRORED * spectrum[line]):
            return sources
    return 0


def bordered(signal: Numbers) -> Finding:
    """Say whether a sweep holds several blocks, by jumps at their borders."""
    jump = _jumps(signal)
    known = np.isfinite(jump)
    count = signal.shape[1]
    usual = float(np.median(jump[known])) if known.any() else 0.0
    for blocks in _BLOCKS:
        if count % blocks or count // blocks < _FEWEST or usual <= 0.0:
            continue
        at = np.arange(1, blocks) * (count // blocks) - 1
        large = [  # NaN compares as False
            a for a in at if jump[a] > max(_JUMP * usual, _ALONE) and np.mean(jump[known] >= jump[a]) <= _RARE
        ]
        if 2 * len(large) >= blocks:
            return Finding(
                False,
                f'between blocks of {count // blocks} samples the signal jumps by {np.mean(jump[large]) / usual:.0f} '
                f'times what it does elsewhere: a sweep seems to hold {blocks} blocks: put receiver, iq, ramp or chirp '
                f'as an axis of size {blocks} before sample',
            )
    return Finding(True, 'no jumps at the borders of blocks')


def _jumps(signal: Numbers) -> Numbers:
    """Return by how much each step differs from its neighbours', over the steps around it (N - 1,).

    Root mean squares over the sweeps; NaN where the samples are limited or an end is near.
    """
    parts = np.concatenate([signal.real, signal.imag]) if np.iscomplexobj(signal) else signal
    margin = _RAIL * (parts.max() - parts.min())
    limited = (parts <= parts.min() + margin) | (parts >= parts.max() - margin)
    step = np.diff(parts, axis=1)
    count = step.shape[1]
    result = np.full(count, np.nan)
    if count <= _AROUND:
        return result
    k = np.arange(_AROUND // 2, count - _AROUND // 2)
    apart = (step[:, k] - 0.5 * (step[:, k - 1] + step[:, k + 1])) ** 2
    around = np.mean([step[:, k + d] ** 2 for d in (-2, -1, 1, 2)], axis=0)
    clear = ~np.any([limited[:, k + d] for d in (-1, 0, 1, 2)], axis=0)
    seen = clear.any(axis=0)
    numerator, denominator = np.sum(apart * clear, axis=0), np.sum(around * clear, axis=0)
    least = 1e-6 * float(np.mean(step**2)) * np.maximum(clear.sum(axis=0), 1)
    result[k[seen]] = np.sqrt(numerator / np.maximum(denominator, least))[seen]
    return result


def cut_short(signal: Numbers) -> list[Finding]:
    """Say whether sweeps go on into the next one, all of them or all but every m-th; nothing where they do not."""
    sweeps, count = signal.shape
    flat = (signal[:_ROWS] - signal[:_ROWS].mean()).reshape(-1)
    if count < 4 * _ORDER or len(flat) < 2 * count:
        return []
    error = _prediction_errors(flat, count)
    at = np.arange(len(error)) + _ORDER
    usual = float(np.median(error[at % count >= _ORDER]))
    if usual <= 0.0:
        return []
    starts = error[at % count == 0] / usual
    number = at[at % count == 0] // count
    for whole in (2, 3, 4, 6, 8):
        classes = [starts[number % whole == r] for r in range(whole)]
        begin = [r for r, values in enumerate(classes) if len(values) and np.median(values) > _BEGINS]
        others = [values for r, values in enumerate(classes) if r not in begin]
        enough = sum(map(len, others)) >= _BORDERS and all(len(values) for values in classes)
        if enough and len(begin) == 1 and max(np.median(values) for values in others) < _GOES_ON:
            return [_too_short(count, whole)]
    power = float(np.median(np.abs(flat) ** 2))
    part = signal[:_ROWS]
    change = float(np.mean(np.abs(np.diff(part, axis=0)) ** 2)) / max(float(np.mean(np.abs(part) ** 2)), 1e-30)
    if len(starts) >= 3 and starts.max() < _GOES_ON and power > _PREDICTED * usual and change > 0.1:
        return [_too_short(count, sweeps)]
    return []


def _too_short(count: int, whole: int) -> Finding:
    return Finding(
        False,
        f'{whole} sweeps of {count} samples seem to be one: each goes on where the one before ends: set layout: shape '
        f'so that sample has size {whole * count}',
    )


def _prediction_errors(flat: Numbers, count: int) -> Numbers:
    """Return the square errors of a linear prediction of each number from those before it (n - order,).

    It is fitted within the sweeps of `count` numbers and goes on across their borders.
    """
    before = np.lib.stride_tricks.sliding_window_view(flat[:-1], _ORDER)[: len(flat) - _ORDER]
    within = (np.arange(len(before)) + _ORDER) % count >= _ORDER
    ridge = 1e-3 * np.sqrt(float(np.mean(np.abs(flat) ** 2)) * max(int(within.sum()), 1))
    design = np.vstack([before[within], ridge * np.eye(_ORDER)])
    wanted = np.concatenate([flat[_ORDER:][within], np.zeros(_ORDER)])
    weights = np.linalg.lstsq(design, wanted, rcond=None)[0]
    errors: Numbers = np.abs(flat[_ORDER:] - before @ weights) ** 2
    return errors
