"""Lines of a sweep found one by one and refined together, as a limiter and a high-pass behind it pass them on."""

import dataclasses
import math
from collections.abc import Sequence

import numpy as np
from scipy.signal import lfilter

from ..compare.algebra import scaled_inverse
from ..finding.result import BeforeAfter, Fit
from .limits import LINES, SHAPE
from .material import Material, representative_sweeps
from .rails import Limit


@dataclasses.dataclass(frozen=True)
class Receiver:
    """What stands between the mixer and the samples."""

    rate: float  # of the samples [Hz]
    level: float = math.inf  # at which it limits [LSB]
    pole: float = 0.0  # of a high-pass behind the limiter [Hz]

    def passed(self, values: np.ndarray) -> np.ndarray:
        """Return what the high-pass leaves of signals (..., N) that begin from rest."""
        if not self.pole:
            return values
        kept = 1.0 / (1.0 + 2.0 * np.pi * self.pole / self.rate)
        filtered: np.ndarray = lfilter([kept, -kept], [1.0, -kept], values, axis=-1)
        return filtered

    def settling(self, count: int) -> np.ndarray:
        """Return what the charge of the high-pass at the first sample adds to so many samples, of unit height."""
        return np.exp(-2.0 * np.pi * self.pole / self.rate * np.arange(count))


@dataclasses.dataclass(frozen=True)
class Lines:
    """Lines that describe one sweep of N samples, whose parts are its real numbers, or those of I and of Q."""

    frequency: np.ndarray  # (k,) [1 / sample]
    phasor: np.ndarray  # (k,) amplitude and phase in mid-sweep [LSB]
    constant: complex  # [LSB]
    charge: np.ndarray  # (parts,) of the high-pass at the first sample [LSB]
    model: np.ndarray  # (parts, N) what they make of the sweep [LSB]
    fitted: float  # mean square of what they leave of the samples fitted [LSB^2]
    held_out: float  # the same of the blocks held out [LSB^2]


def limited_fit(m: Material, found: Limit) -> tuple[Fit, float, str]:
    """Return the misfit of lines over the noise, without and with what limits them, numbers held out, and it in words.

    As many lines as the blocks held out demand with the limit and its high-pass, both as the samples at the limit
    showed them and not fitted; as many again without. The noise is white.
    """
    receiver = Receiver(m.rate, found.level, found.pole[0] if found.pole is not None else 0.0)
    limited = found.at.reshape(-1, *m.signal.shape).any(axis=0).mean(axis=1)
    after, before, most, of = [], [], [], []
    for sweep, averaged in representative_sweeps(m, LINES.items, limited):
        of.append(averaged)
        after.append(demanded(joint_lines(sweep, receiver)))
        without = joint_lines(sweep, Receiver(m.rate), len(after[-1].frequency))
        before.append(without[len(after[-1].frequency)])
        most.append(demanded(without))

    def over_noise(lines: Sequence[Lines], name: str) -> float:
        return float(np.mean([n * getattr(x, name) for n, x in zip(of, lines, strict=True)])) / m.white**2

    inside, outside = (BeforeAfter(over_noise(before, n), over_noise(after, n)) for n in ('fitted', 'held_out'))
    left = [math.sqrt(float(np.mean([x.held_out for x in lines]))) for lines in (after, before, most)]
    behind, them = ('limit and the high-pass', 'them') if found.pole else ('limit', 'it')
    text = (
        f'{_counted(after)} lines before the {behind} found leave {left[0]:.1f} LSB rms of the samples that '
        f'were held out; without {them} {_counted(before)} lines leave {left[1]:.1f}, and {_counted(most)} leave '
        f'{left[2]:.1f}.'
    )
    held = sum(np.size(x.model) for x in after) / SHAPE.every
    return Fit(inside, outside), held, text


def _counted(found: Sequence[Lines]) -> str:
    """Return how many lines describe a sweep, in words."""
    fewest, most = (pick(len(x.frequency) for x in found) for pick in (min, max))
    return f'{most}' if fewest == most else f'{fewest} to {most}'


def joint_lines(sweep: np.ndarray, receiver: Receiver, fewest: int = 0) -> list[Lines]:
    """Return descriptions of a sweep (N,), real or complex, by no line, one, two, and so on.

    Each line begins at the strongest bin of what the others leave; then all are refined together (Levenberg and
    Marquardt). It ends when further lines no longer describe the blocks held out better, with at least `fewest` lines.
    """
    sweep = sweep[: LINES.longest]
    fitting = _Fitting(sweep, receiver)
    found = [fitting.refined(np.zeros(0), np.zeros(0, complex), complex(np.mean(sweep)))]
    while len(found) <= fewest or (len(found) <= LINES.most and len(found) - _best(found) <= LINES.patience):
        found.append(fitting.with_another(found[-1]))
    return found


def demanded(found: Sequence[Lines]) -> Lines:
    """Return the description with as many lines as the blocks held out demand, of `joint_lines`."""
    return found[_best(found)]


def _best(found: Sequence[Lines]) -> int:
    best = 0
    for number, lines in enumerate(found):
        if lines.held_out < (1.0 - LINES.helps) * found[best].held_out:
            best = number
    return best


class _Fitting:
    """Lines of one sweep."""

    def __init__(self, sweep: np.ndarray, receiver: Receiver) -> None:
        self.receiver = receiver
        self.iq = bool(np.iscomplexobj(sweep))
        self.measured = self._parts(sweep)
        self.count = len(sweep)
        self.time = np.arange(self.count) - 0.5 * (self.count - 1)
        length = max(1, self.count // LINES.blocks)
        self.held = np.arange(self.count) // length % SHAPE.every == SHAPE.every // 2
        self._window = np.hanning(self.count + 2)[1:-1] * ~self.held

    def _parts(self, values: np.ndarray) -> np.ndarray:
        """Return the real numbers of signals (..., parts, N)."""
        return np.stack([values.real, values.imag], axis=-2) if self.iq else np.asarray(values.real)[..., None, :]

    def _model(
        self, frequency: np.ndarray, phasor: np.ndarray, constant: complex, charge: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Return what lines make of the sweep (parts, N), before the limiter as well, and their oscillations (k, N)."""
        waves = np.exp(2j * np.pi * frequency[:, None] * self.time)
        before = self._parts(phasor @ waves + constant)
        level = self.receiver.level
        after = self.receiver.passed(np.clip(before, -level, level))
        if self.receiver.pole:
            after = after + charge[:, None] * self.receiver.settling(self.count)
        return after, before, waves

    def _slopes(self, waves: np.ndarray, phasor: np.ndarray, before: np.ndarray) -> np.ndarray:
        """Return derivatives by amplitudes, frequencies, constant and charge (P, parts, N)."""
        one = np.ones((1, self.count))
        turning = 2j * np.pi * self.time * phasor[:, None] * waves
        each = [self._parts(x) for x in (waves, 1j * waves, turning, one, *([1j * one] if self.iq else []))]
        inside = np.abs(before) < self.receiver.level
        slopes = self.receiver.passed(np.concatenate(each) * inside)
        if self.receiver.pole:
            slopes = np.concatenate([slopes, np.eye(len(before))[:, :, None] * self.receiver.settling(self.count)])
        return slopes

    def with_another(self, found: Lines) -> Lines:
        """Return the lines with one more at the strongest bin of what they leave, all refined."""
        left = self.measured - found.model
        rest = (left[0] + 1j * left[1] if self.iq else left[0]) * self._window
        length = LINES.padding * self.count
        spectrum = np.abs(np.fft.fft(rest, length))
        cells = LINES.padding * LINES.lowest
        bins = np.arange(length)
        usable = (np.minimum(bins, length - bins) >= cells) & (self.iq | (bins < length // 2))
        at = int(np.argmax(np.where(usable, spectrum, 0.0)))
        frequency = at / length - (at > length // 2)
        own = np.sum(rest * np.exp(-2j * np.pi * frequency * self.time)) / np.sum(self._window)
        phasor = own if self.iq else 2.0 * own
        return self.refined(
            np.append(found.frequency, frequency), np.append(found.phasor, phasor), found.constant, found.charge
        )

    def refined(
        self, frequency: np.ndarray, phasor: np.ndarray, constant: complex, charge: np.ndarray | None = None
    ) -> Lines:
        """Return lines with all that describes them fitted to the samples that are not held out."""
        used = ~self.held
        point = (frequency, phasor, constant, np.zeros(len(self.measured)) if charge is None else charge)
        model, before, waves = self._model(*point)
        cost, damping = self._fitted(model), LINES.damping
        for _ in range(LINES.rounds):
            slopes = self._slopes(waves, point[1], before)[..., used]
            slopes = slopes.reshape(len(slopes), -1)
            normal, gradient = slopes @ slopes.T, slopes @ (self.measured - model)[:, used].ravel()
            for _ in range(LINES.trials):
                step = scaled_inverse(normal + damping * np.diag(np.diag(normal))) @ gradient
                trial = self._moved(point, step)
                trial_model, trial_before, trial_waves = self._model(*trial)
                trial_cost = self._fitted(trial_model)
                if trial_cost < cost:
                    break
                damping *= 10.0
            else:
                break
            settled = cost - trial_cost < LINES.settled * cost
            point, model, before, waves, cost = trial, trial_model, trial_before, trial_waves, trial_cost
            damping = max(damping / 10.0, 1e-9)
            if settled:
                break
        return Lines(*point, model, cost, float(np.mean((self.measured - model)[:, self.held] ** 2)))

    def _fitted(self, model: np.ndarray) -> float:
        """Return the mean square of what a model leaves of the samples fitted [LSB^2]."""
        return float(np.mean((self.measured - model)[:, ~self.held] ** 2))

    def _moved(
        self, point: tuple[np.ndarray, np.ndarray, complex, np.ndarray], step: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray, complex, np.ndarray]:
        """Return parameters a step on, frequencies at most half a resolution cell."""
        frequency, phasor, constant, charge = point
        lines = len(frequency)
        real, imaginary, change, rest = np.split(step, [lines, 2 * lines, 3 * lines])
        most = 0.5 / self.count
        moved = constant + complex(rest[0], rest[1] if self.iq else 0.0)
        left = rest[2 if self.iq else 1 :]
        return (
            frequency + np.clip(change, -most, most),
            phasor + real + 1j * imaginary,
            moved,
            charge + left if len(left) else charge,
        )
