"""What one strong line says about the ramp: where it is straight, and how its rate changes over the band."""

import dataclasses
import math

import numpy as np
from numpy.polynomial.legendre import legvander
from scipy.interpolate import BSpline

from ..limits import SHAPE, WINDOW
from ..material import Material, averaged, representative_sweeps
from .shape import Line, Score, Shape, followed, learn, refit, score
from .window import Window, window


@dataclasses.dataclass(frozen=True)
class Ramp:
    """One strong line of a station that hears itself, beside a straight ramp and beside the one that was learnt."""

    material: Material
    window: Window
    lines: tuple[Line, ...]  # sweeps, or means of groups of sweeps that are alike
    shape: Shape
    straight: tuple[Score, ...]  # of each line, a straight ramp within the window
    recorded: np.ndarray  # (N,) the first of the lines, outside its window as well [LSB]
    nominal: float  # held-out rms of a straight line and a constant over the whole record [LSB]

    @property
    def fitted(self) -> float:
        """Root mean square of what the shape leaves of the samples fitted [LSB]."""
        return _pooled([s.fitted for s in self.shape.scores])

    @property
    def white(self) -> float:
        """Standard deviation of the white noise of the lines [LSB]."""
        return _pooled([self.material.white / math.sqrt(line.averaged) for line in self.lines])

    @property
    def held_out(self) -> float:
        """The same of the blocks held out [LSB]."""
        return _pooled([s.held_out for s in self.shape.scores])

    @property
    def bends(self) -> bool:
        """A shape describes the ramp much better than a straight one, and it is no mere parabola of the frequency."""
        rate = self.rate()
        place = np.linspace(-1.0, 1.0, len(rate))
        curved = rate - np.polyval(np.polyfit(place, rate, 1), place)
        better = self.held_out < SHAPE.gain * _pooled([s.held_out for s in self.straight])
        return better and float(np.std(rate)) > SHAPE.least and float(np.std(curved)) > 0.5 * float(np.std(rate))

    @property
    def narrower(self) -> tuple[bool, bool]:
        """The ramp's window begins later, and ends earlier, than the nominal ramp and the line's delay say."""
        delay = float(np.max(self.shape.delay)) * self.material.rate
        return (
            self.window.first > delay + WINDOW.least,
            self.window.last < self.material.nominal_end - WINDOW.least,
        )

    @property
    def beyond(self) -> tuple[float, int]:
        """Root mean square of what a ramp that goes on beyond the window leaves of the first line there, and of how
        many samples [LSB]."""
        m, line, psi = self.material, self.lines[0], self.shape.phase[0]
        sample = np.arange(m.nominal_end)
        sample = sample[(sample < line.sample[0]) | (sample > line.sample[-1])]
        sample = sample[sample > float(np.max(self.shape.delay)) * m.rate + WINDOW.least]
        if not len(sample):
            return 0.0, 0
        span = min(8, len(psi) - 1)
        early, late = (psi[span] - psi[0]) / span, (psi[-1] - psi[-1 - span]) / span
        before = psi[0] + early * (sample - line.sample[0])
        angle = np.where(sample < line.sample[0], before, psi[-1] + late * (sample - line.sample[-1]))
        linear, place = self.shape.scores[0].linear, np.where(sample < line.sample[0], -1.0, 1.0)
        constant = legvander(place, SHAPE.constant) @ linear[: SHAPE.constant + 1]
        at = SHAPE.constant + 1
        amplitude = legvander(place, SHAPE.amplitude) @ linear[at : at + SHAPE.amplitude + 1]
        rest = self.recorded[sample] - constant - amplitude * np.cos(angle)
        return float(np.sqrt(np.mean(rest**2))), len(sample)

    def rate(self) -> np.ndarray:
        """Return the relative rate at the samples of the first line; mean 1."""
        values = self.shape.over(self.lines[0].frequency)
        return values / np.mean(values)

    def over_nominal(self) -> tuple[np.ndarray, np.ndarray, float]:
        """Return the shape as `sweep_shape` declares it.

        Returns:
            coefficients on a uniform spline over the nominal ramp, mean 1 where the ramp was seen; their standard
            deviations; the nominal rate over that of the window, by which the delay grows if the ramp is taken to be
            as long as nominal.
        """
        m, w = self.material, self.window
        count = len(self.shape.std)
        inner = np.linspace(0.0, 1.0, count - 2)
        knots = np.concatenate([np.zeros(3), inner, np.ones(3)])
        sample = np.arange(w.first, w.last)
        share = sample / (m.duration * m.rate)
        frequency = m.start_frequency + m.bandwidth * (sample - w.begins) / w.length
        design = BSpline.design_matrix(np.clip(share, 0.0, 1.0), knots, 3).toarray()
        weak = 0.02 * math.sqrt(len(sample)) * np.diff(np.eye(count), axis=0)  # constant where nothing was seen
        values = self.shape.over(frequency) / np.mean(self.shape.over(frequency))
        right = np.concatenate([values, np.zeros(count - 1)])
        coefficients = np.linalg.lstsq(np.vstack([design, weak]), right, rcond=None)[0]
        return np.maximum(coefficients, SHAPE.slowest), self.shape.std, float(m.duration * m.rate / w.length)

    @property
    def slope(self) -> tuple[float, float]:
        """Loss of amplitude from start to end of the nominal ramp, linear in dB, and its standard deviation [dB]."""
        line, amplitude = self.lines[0], np.abs(self._amplitude)
        level = 20.0 * np.log10(np.maximum(amplitude, 1e-3 * amplitude.max()))
        share = line.sample / (self.material.duration * self.material.rate)
        slope, at_start = np.polyfit(share, level, 1)
        rest = level - np.polyval([slope, at_start], share)
        return -float(slope), float(np.std(rest) / np.std(share) / math.sqrt(SHAPE.amplitude))

    @property
    def _amplitude(self) -> np.ndarray:
        linear, at = self.shape.scores[0].linear, SHAPE.constant + 1
        values: np.ndarray = legvander(self.lines[0].place, SHAPE.amplitude) @ linear[at : at + SHAPE.amplitude + 1]
        return values

    @property
    def amplitude(self) -> float:
        """Root-mean-square amplitude of the first line [LSB]."""
        return float(np.sqrt(np.mean(self._amplitude**2)))

    @property
    def constant(self) -> float:
        """Peak to peak of the slowly varying constant [LSB]."""
        line, linear = self.lines[0], self.shape.scores[0].linear
        return float(np.ptp(legvander(line.place, SHAPE.constant) @ linear[: SHAPE.constant + 1]))


def ramp(m: Material) -> Ramp | None:
    """Return what the strongest line says about the ramp, None where no single line is strong enough."""
    m = averaged(m, m.nominal_end // SHAPE.longest)
    count = m.nominal_end
    if count < SHAPE.fewest_samples:
        return None
    items = representative_sweeps(dataclasses.replace(m, signal=m.signal.real), SHAPE.items)
    period = _period(items[0][0][:count])
    if not period:
        return None
    bounds = window(m, period)
    lines = [_line(m, bounds, *item) for item in items]
    starts = [followed(line) if len(line.signal) >= SHAPE.fewest_samples else None for line in lines]
    pairs = [(x, s) for x, s in zip(lines, starts, strict=True) if s is not None and s[2] < SHAPE.share]
    if not pairs:
        return None
    shape = learn([x for x, _ in pairs], [s[1] for _, s in pairs])
    straight = tuple(_straight(x, psi) for (x, _), psi in zip(pairs, shape.phase, strict=True))
    found = Ramp(
        m, bounds, tuple(x for x, _ in pairs), shape, straight, items[0][0], _nominal(items[0][0][:count], period)
    )
    turns = min(abs(float(psi[-1] - psi[0])) for psi in shape.phase) / (2.0 * np.pi)
    clear = 2.0 * found.held_out**2 < SHAPE.rest * found.amplitude**2
    return found if clear and turns > SHAPE.fewest_turns - 1.0 else None


def _straight(line: Line, psi: np.ndarray) -> Score:
    """Return how well a straight ramp describes a line whose phase is about psi (n,) [rad]."""
    turn = 2.0 * np.pi * (line.frequency - line.frequency[0])
    delay, offset = np.polyfit(turn, psi, 1)
    at_first = score(line, delay * turn + offset)
    after = refit(line, turn, float(delay), float(offset))[2]
    return min(at_first, after, key=lambda s: s.fitted)


def _period(signal: np.ndarray) -> float:
    """Return the period of the strongest line [samples], 0 where there is none."""
    count = len(signal)
    slow = legvander(np.linspace(-1.0, 1.0, count), SHAPE.constant)
    flat = signal - slow @ np.linalg.lstsq(slow, signal, rcond=None)[0]
    power = np.abs(np.fft.rfft(flat * np.hanning(count))) ** 2
    low, high = math.ceil(SHAPE.fewest_turns), int(SHAPE.most_turns * count)
    peak = low + int(np.argmax(power[low:high]))
    return count / peak if np.sum(power[max(peak - 6, 0) : peak + 7]) > SHAPE.strong * np.sum(power[2:]) else 0.0


def _line(m: Material, bounds: Window, signal: np.ndarray, averaged: int) -> Line:
    sample = np.arange(bounds.first, bounds.last)
    frequency = m.start_frequency + m.bandwidth * (sample - bounds.begins) / bounds.length
    if m.bandwidth < 0.0:  # a falling ramp: the same phases over rising distances from its start
        frequency = m.start_frequency - m.bandwidth * (sample - bounds.begins) / bounds.length
    return Line(signal[sample], frequency, sample, averaged)


def _nominal(signal: np.ndarray, period: float) -> float:
    """Return the held-out rms of a constant and the straight line that fits best [LSB]."""
    count = len(signal)
    line = Line(signal, np.arange(count, dtype=float), np.arange(count))
    held, best = line.held, (np.inf, np.inf)
    for turns in np.arange(-SHAPE.near, SHAPE.near, 0.05) + count / period:
        psi = 2.0 * np.pi * turns * np.arange(count) / count
        design = np.stack([np.ones(count), np.cos(psi), np.sin(psi)], axis=1)
        rest = signal - design @ np.linalg.lstsq(design[~held], signal[~held], rcond=None)[0]
        best = min(best, (float(np.mean(rest[~held] ** 2)), float(np.sqrt(np.mean(rest[held] ** 2)))))
    return best[1]


def _pooled(values: list[float]) -> float:
    return float(np.sqrt(np.mean(np.square(values))))
