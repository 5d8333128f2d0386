"""The ramp's rate over frequency, learnt from lines: variable projection, several sweeps or settings at once.

A line shows psi(t) = 2 pi tau (f(t) - f(t0)) + phi. So its phase determines the shape of f up to a scale. The rate over
its nominal value is a cubic spline over the nominal frequency; settings of one oscillator share it. Constant, amplitude
and harmonics of the line are slow polynomials, which are linear and projected out. Source: Golub and Pereyra
(1973) for the projection, with Kaufman's simplification.
"""

import dataclasses
from collections.abc import Callable, Sequence

import numpy as np
from numpy.polynomial.legendre import legvander
from scipy.interpolate import BSpline

from ..limits import SHAPE


@dataclasses.dataclass(frozen=True)
class Line:
    """One sweep, or the mean of several, within its window."""

    signal: np.ndarray  # (n,) real [LSB]
    frequency: np.ndarray  # (n,) nominal frequency of the ramp at each sample [Hz]
    sample: np.ndarray  # (n,) numbers of the samples
    averaged: int = 1  # sweeps of which it is the mean

    @property
    def held(self) -> np.ndarray:
        """Samples that are held out, in blocks, (n,) bool."""
        return np.arange(len(self.sample)) // SHAPE.hold % SHAPE.every == SHAPE.every // 2

    @property
    def place(self) -> np.ndarray:
        """The samples' places, -1 ... 1 over the window."""
        return np.linspace(-1.0, 1.0, len(self.sample))

    def design(self, psi: np.ndarray, harmonics: bool) -> np.ndarray:
        """Return the columns that are linear, (n, columns): constant, the line's amplitude, its harmonics."""
        place = self.place
        slow = legvander(place, SHAPE.harmonic)
        columns = [legvander(place, SHAPE.constant), legvander(place, SHAPE.amplitude) * np.cos(psi)[:, None]]
        if harmonics:
            columns += [slow * turn(order * psi)[:, None] for order in (2, 3) for turn in (np.cos, np.sin)]
        return np.hstack(columns)

    def slope(self, psi: np.ndarray, linear: np.ndarray) -> np.ndarray:
        """Return the derivative of the model by psi (n,), for the coefficients of `design`'s columns."""
        place = self.place
        at = SHAPE.constant + 1
        result = -(legvander(place, SHAPE.amplitude) @ linear[at : at + SHAPE.amplitude + 1]) * np.sin(psi)
        at += SHAPE.amplitude + 1
        if at < len(linear):
            slow = legvander(place, SHAPE.harmonic)
            for order, (c, s) in zip((2, 3), linear[at:].reshape(2, 2, -1), strict=True):
                result += order * ((slow @ s) * np.cos(order * psi) - (slow @ c) * np.sin(order * psi))
        return result


@dataclasses.dataclass(frozen=True)
class Score:
    """Root mean square of what a model of one line leaves [LSB], on the samples fitted and on the blocks held out."""

    fitted: float
    held_out: float
    residual: np.ndarray  # (n,) [LSB]
    linear: np.ndarray  # coefficients of `Line.design`


def score(line: Line, psi: np.ndarray) -> Score:
    """Return how well a phase over the sweep (n,) [rad] describes a line."""
    design, held = line.design(psi, True), line.held
    linear = np.linalg.lstsq(design[~held], line.signal[~held], rcond=None)[0]
    residual = line.signal - design @ linear
    return Score(_rms(residual[~held]), _rms(residual[held]), residual, linear)


def refit(line: Line, turn: np.ndarray, delay: float, offset: float) -> tuple[float, float, Score]:
    """Return delay, phase and score of a line on a ramp that is known, by Gauss and Newton.

    Args:
        line: one sweep.
        turn: phase per delay at its samples (n,) [rad/s].
        delay: to start with [s].
        offset: phase to start with [rad].
    """
    for _ in range(SHAPE.rounds):
        now = score(line, delay * turn + offset)
        by_psi = line.slope(delay * turn + offset, now.linear)
        free = np.stack([by_psi * turn, by_psi], axis=1)
        scale = np.maximum(np.sqrt(np.mean(free**2, axis=0)), 1e-30)
        design = np.hstack([free / scale, line.design(delay * turn + offset, True)])[~line.held]
        step = np.linalg.lstsq(design, now.residual[~line.held], rcond=None)[0][:2] / scale
        delay, offset = delay + float(step[0]), offset + float(step[1])
        if abs(step[0]) < SHAPE.settled * abs(delay):
            break
    return delay, offset, score(line, delay * turn + offset)


@dataclasses.dataclass(frozen=True)
class Shape:
    """A ramp's rate over its nominal one, and the delays of the lines that it was learnt from."""

    spline: BSpline  # over the nominal frequency [Hz]; mean 1 over the frequencies that all lines cover
    std: np.ndarray  # standard deviations of its coefficients
    delay: np.ndarray  # (lines,) [s]; their common scale is a convention
    delay_std: np.ndarray  # (lines,) of the fit alone [s]
    phase: tuple[np.ndarray, ...]  # of each line at its samples [rad]
    scores: tuple[Score, ...]

    def over(self, frequency: np.ndarray) -> np.ndarray:
        """Return the relative rate at nominal frequencies [Hz]."""
        values: np.ndarray = self.spline(frequency)
        return values


def followed(line: Line) -> tuple[float, np.ndarray, float] | None:
    """Return (turns, phase (n,) [rad], residual power over the line's on what is held out) of the strongest line.

    A straight line is tried first; then its complex amplitude, allowed to vary faster from round to round, takes the
    bend of the phase. None where no line has periods enough.
    """
    count, held = len(line.signal), line.held
    place = line.place
    constant = legvander(place, SHAPE.constant)
    flat = line.signal - constant @ np.linalg.lstsq(constant, line.signal, rcond=None)[0]
    power = np.abs(np.fft.rfft(flat * np.hanning(count))) ** 2
    low, high = int(np.ceil(SHAPE.fewest_turns)), int(SHAPE.most_turns * count)
    if high <= low + 1:
        return None
    peak = low + int(np.argmax(power[low:high]))
    best = (np.inf, float(peak))
    for turns in np.arange(max(peak - SHAPE.near, SHAPE.fewest_turns), min(peak + SHAPE.near, high), 0.25):
        psi = np.pi * turns * (place + 1.0)
        amplitude = legvander(place, 2)
        turned = amplitude * np.cos(psi)[:, None], amplitude * np.sin(psi)[:, None]
        base, _ = np.linalg.qr(np.hstack([constant, *turned]))
        best = min(best, (float(np.sum((line.signal - base @ (base.T @ line.signal)) ** 2)), float(turns)))
    psi = np.pi * best[1] * (place + 1.0)
    for order in SHAPE.orders:
        amplitude = legvander(place, order)
        design = np.hstack([constant, amplitude * np.cos(psi)[:, None], amplitude * np.sin(psi)[:, None]])
        linear = np.linalg.lstsq(design[~held], line.signal[~held], rcond=None)[0]
        own = design[:, constant.shape[1] :] @ linear[constant.shape[1] :]
        rest = line.signal - design @ linear
        inphase, quadrature = linear[constant.shape[1] :].reshape(2, -1)
        psi = psi + np.unwrap(np.angle(amplitude @ inphase - 1j * (amplitude @ quadrature)))
    share = float(np.sum(rest[held] ** 2) / max(np.sum(own[held] ** 2), 1e-30))
    return float((psi[-1] - psi[0]) / (2.0 * np.pi)), psi, share


def learn(lines: Sequence[Line], phases: Sequence[np.ndarray]) -> Shape:
    """Return the shape of the ramp that all lines share.

    Args:
        lines: of one oscillator, at any delays and settings.
        phases: as `followed`, from which the fit starts.
    """
    low = min(float(line.frequency[0]) for line in lines)
    high = max(float(line.frequency[-1]) for line in lines)
    delays = np.array(
        [np.ptp(p) / (2.0 * np.pi * np.ptp(line.frequency)) for line, p in zip(lines, phases, strict=True)]
    )
    turns = float(delays.max()) * (high - low)
    fit = _Fit(lines, low, high)
    rate: Callable[[np.ndarray], np.ndarray] = np.ones_like
    offsets = np.array([p[0] for p in phases])
    for number, per_turn in enumerate(SHAPE.intervals):
        intervals = int(np.clip(per_turn * turns, SHAPE.fewest_intervals, SHAPE.most_intervals))
        start = fit.refine(intervals, rate)
        if number == 0:
            start, delays, offsets = fit.by_phases(phases, start, delays, offsets)
        coefficients, delays, offsets, covariance = fit.run(start, delays, offsets, number > 0)
        rate = fit.spline(coefficients)
    shared = np.linspace(max(x.frequency[0] for x in lines), min(x.frequency[-1] for x in lines), 1000)
    mean = float(np.mean(rate(shared)))
    psi = tuple(
        2.0 * np.pi * d * fit.integral(line, coefficients) + p
        for d, p, line in zip(delays, offsets, lines, strict=True)
    )
    scores = tuple(score(line, p) for line, p in zip(lines, psi, strict=True))
    stds = np.sqrt(np.diag(covariance))
    count = len(lines)
    return Shape(
        fit.spline(coefficients / mean),
        stds[2 * count :] / mean,
        delays * mean,
        stds[:count] * mean,
        psi,
        scores,
    )


class _Fit:
    """The non-linear parameters: delays and phases of the lines, coefficients of the spline."""

    def __init__(self, lines: Sequence[Line], low: float, high: float) -> None:
        self.lines, self.low, self.high = lines, low, high

    def refine(self, intervals: int, rate: Callable[[np.ndarray], np.ndarray]) -> np.ndarray:
        """Take so many intervals, and return the coefficients that come near a rate."""
        inner = np.linspace(self.low, self.high, intervals + 1)
        self.knots = np.concatenate([[self.low] * SHAPE.degree, inner, [self.high] * SHAPE.degree])
        self.size = intervals + SHAPE.degree
        sites = np.array([np.mean(self.knots[i + 1 : i + 1 + SHAPE.degree]) for i in range(self.size)])
        whole = [BSpline(self.knots, unit, SHAPE.degree).antiderivative() for unit in np.eye(self.size)]
        self.integrals = [
            np.stack([w(line.frequency) - w(line.frequency[0]) for w in whole], axis=1) for line in self.lines
        ]
        return rate(sites)

    def spline(self, coefficients: np.ndarray) -> BSpline:
        return BSpline(self.knots, coefficients, SHAPE.degree)

    def integral(self, line: Line, coefficients: np.ndarray) -> np.ndarray:
        whole = self.spline(coefficients).antiderivative()
        values: np.ndarray = whole(line.frequency) - whole(line.frequency[0])
        return values

    def by_phases(
        self, phases: Sequence[np.ndarray], start: np.ndarray, delays: np.ndarray, offsets: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Return coefficients, delays and offsets that come near the phases that were followed."""
        coefficients, delays, offsets = start, delays.copy(), offsets.copy()
        for _ in range(5):
            rows, right = [np.eye(self.size) / SHAPE.ridge], [np.ones(self.size) / SHAPE.ridge]
            for i, (psi, integral) in enumerate(zip(phases, self.integrals, strict=True)):
                turn = 2.0 * np.pi * (integral @ coefficients)
                delays[i], offsets[i] = np.polyfit(turn, psi, 1)
                rows.append(2.0 * np.pi * delays[i] * integral / SHAPE.loose)
                right.append((psi - offsets[i]) / SHAPE.loose)
            coefficients = np.linalg.lstsq(np.vstack(rows), np.concatenate(right), rcond=None)[0]
        return coefficients, delays, offsets

    def run(
        self, coefficients: np.ndarray, delays: np.ndarray, offsets: np.ndarray, harmonics: bool
    ) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
        """Return coefficients, delays, offsets and the covariance of (delays, offsets, coefficients)."""
        count = len(self.lines)
        values = np.concatenate([delays, offsets, coefficients])
        damping = 1e-3
        for _ in range(SHAPE.rounds):
            rest, jacobian = self._project(values, harmonics, True)
            noise = np.concatenate([np.full(len(r), _rms(r)) for r in rest])
            whitened = np.concatenate(rest) / noise
            ridge = np.zeros((self.size, len(values)))
            ridge[:, 2 * count :] = np.eye(self.size) / SHAPE.ridge
            slope = np.vstack([np.vstack(jacobian) / noise[:, None], ridge])
            normal = slope.T @ slope
            right = slope.T @ np.concatenate([whitened, (1.0 - values[2 * count :]) / SHAPE.ridge])
            now = float(whitened @ whitened + np.sum(((values[2 * count :] - 1.0) / SHAPE.ridge) ** 2))
            for _ in range(8):
                scale = np.diag(np.diag(normal)) * damping
                tried = values + np.linalg.solve(normal + scale, right)
                after = np.concatenate(self._project(tried, harmonics, False)[0]) / noise
                cost = float(after @ after + np.sum(((tried[2 * count :] - 1.0) / SHAPE.ridge) ** 2))
                if cost < now:
                    break
                damping *= 5.0
            else:
                break
            values, damping = tried, max(damping / 5.0, 1e-9)
            if now - cost < SHAPE.fit * now:
                break
        return values[2 * count :], values[:count], values[count : 2 * count], np.linalg.inv(normal)

    def _project(self, values: np.ndarray, harmonics: bool, slopes: bool) -> tuple[list[np.ndarray], list[np.ndarray]]:
        """Return residuals of the samples that are fitted, and their slopes by `values`, beside the linear part."""
        count = len(self.lines)
        rests, jacobians = [], []
        for i, (line, integral) in enumerate(zip(self.lines, self.integrals, strict=True)):
            fitted = ~line.held
            turn = 2.0 * np.pi * (integral @ values[2 * count :])
            psi = values[i] * turn + values[count + i]
            design = line.design(psi, harmonics)
            base, triangle = np.linalg.qr(design[fitted])
            shadow = base.T @ line.signal[fitted]
            rests.append(line.signal[fitted] - base @ shadow)
            if slopes:
                by_psi = line.slope(psi, np.linalg.lstsq(triangle, shadow, rcond=None)[0])[fitted]
                jacobian = np.zeros((len(by_psi), len(values)))
                jacobian[:, i], jacobian[:, count + i] = by_psi * turn[fitted], by_psi
                jacobian[:, 2 * count :] = (2.0 * np.pi * values[i] * by_psi)[:, None] * integral[fitted]
                jacobians.append(jacobian - base @ (base.T @ jacobian))
        return rests, jacobians


def _rms(values: np.ndarray) -> float:
    return float(np.sqrt(np.mean(values**2)))
