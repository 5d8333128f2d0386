"""Lines of many sweeps: each has a frequency that all sweeps share or that moves, and an amplitude in each sweep."""

import dataclasses
import math
from collections.abc import Callable

import numpy as np
from scipy.special import gammaincc

from ..limits import NOISE
from ..noise import Noise
from .limits import FORWARD

Shaping = Callable[[np.ndarray], np.ndarray]
"""Returns factors (..., N) of the waves of lines at frequencies (...) [1 / sample]."""


@dataclasses.dataclass(frozen=True)
class Tracks:
    """Lines found in n sweeps of N samples."""

    frequency: np.ndarray  # (L, order) Legendre coefficients over the sweeps [1 / sample]

    def at(self, place: np.ndarray) -> np.ndarray:
        """Return the frequencies at places of sweeps (n,), -1 first and 1 last, (n, L) [1 / sample]."""
        return basis(place, self.frequency.shape[1]) @ self.frequency.T

    def __len__(self) -> int:
        """Return the number of lines."""
        return len(self.frequency)


def basis(place: np.ndarray, order: int) -> np.ndarray:
    """Return Legendre polynomials at places (n,), (n, order)."""
    return np.polynomial.legendre.legvander(place, order - 1)


@dataclasses.dataclass
class Sweeps:
    """Sweeps to which lines are fitted."""

    signal: np.ndarray  # (n, N) real or complex [LSB]
    place: np.ndarray  # (n,) in the recording, -1 first and 1 last
    used: np.ndarray  # (n, N) samples that are fitted, bool

    def rows(self, rows: np.ndarray) -> 'Sweeps':
        """Return some of them."""
        return Sweeps(self.signal[rows], self.place[rows], self.used[rows])

    @property
    def iq(self) -> bool:
        """Complex samples."""
        return bool(np.iscomplexobj(self.signal))

    @property
    def time(self) -> np.ndarray:
        """Samples (N,) from mid-sweep."""
        return np.arange(self.signal.shape[1]) - 0.5 * (self.signal.shape[1] - 1)


@dataclasses.dataclass
class Solved:
    """Lines with their amplitudes in each sweep."""

    phasor: np.ndarray  # (n, L) in mid-sweep [LSB]
    constant: np.ndarray  # (n,) [LSB]
    model: np.ndarray  # (n, N) [LSB]
    waves: np.ndarray  # (n, L, N)
    design: np.ndarray  # (n, K, N) columns of the linear fit, zero where samples are not used
    inverse: np.ndarray  # (n, K, K) of its normal matrix


def waves(s: Sweeps, tracks: Tracks, shaping: Shaping | None = None) -> np.ndarray:
    """Return waves of unit amplitude (n, L, N)."""
    frequency = tracks.at(s.place)
    turning = _turning(frequency, s.time)
    return turning if shaping is None else turning * shaping(frequency)


def _turning(frequency: np.ndarray, time: np.ndarray) -> np.ndarray:
    """Return exp(2j pi frequency time) (..., N) at evenly spaced times (N,): products of few exponentials."""
    fine = math.isqrt(len(time)) + 1
    turns = 2j * np.pi * frequency[..., None]
    begin, within = np.exp(turns * time[::fine]), np.exp(turns * (time[:fine] - time[0]))
    whole = begin[..., None] * within[..., None, :]
    result: np.ndarray = whole.reshape(*frequency.shape, whole.shape[-2] * fine)[..., : len(time)]
    return result


def solve(s: Sweeps, tracks: Tracks, shaping: Shaping | None = None, signal: np.ndarray | None = None) -> Solved:
    """Return the amplitudes, sweep by sweep, that describe the samples used best.

    `signal` (n, N) takes the place of the recorded samples.
    """
    measured = s.signal if signal is None else signal
    own = waves(s, tracks, shaping)
    one = np.ones((len(own), 1, own.shape[2]))
    columns = np.concatenate([one, own], axis=1) if s.iq else np.concatenate([one, own.real, own.imag], axis=1)
    design = columns * s.used[:, None, :]
    normal = np.matmul(design.conj(), design.swapaxes(1, 2))
    scale = np.einsum('nkk->nk', normal).real
    ridge = np.einsum('nk,kl->nkl', FORWARD.ridge * scale + 1e-12, np.eye(normal.shape[1]))
    inverse = np.linalg.inv(normal + ridge)
    right = np.matmul(design.conj(), (measured * s.used)[..., None])
    weights = np.matmul(inverse, right)[..., 0]
    model = np.matmul(weights[:, None, :], columns)[:, 0]
    lines = len(tracks)
    phasor = weights[:, 1:] if s.iq else weights[:, 1 : lines + 1] - 1j * weights[:, lines + 1 :]
    return Solved(phasor, weights[:, 0], model, own, design, inverse)


def slopes(s: Sweeps, found: Solved) -> np.ndarray:
    """Return by how much the samples change with the frequency of each line (n, L, N) [LSB samples]."""
    change: np.ndarray = found.waves * (2j * np.pi * s.time) * found.phasor[..., None]
    return change if s.iq else change.real


@dataclasses.dataclass(frozen=True)
class Normal:
    """Normal equations of M parameters, in units that make the diagonal of the matrix one."""

    matrix: np.ndarray  # (M, M) [1]
    right: np.ndarray  # (M,) in the parameters' own units
    scale: np.ndarray  # (M,) roots of the diagonal in the parameters' own units

    def step(self, damping: float) -> np.ndarray:
        """Return the damped step of the parameters (M,) (Levenberg)."""
        step: np.ndarray = np.linalg.solve(self._ridged(damping), self.right / self.scale) / self.scale
        return step

    def inverse(self, ridge: float) -> np.ndarray:
        """Return the inverse of the matrix (M, M) in the parameters' own units: their covariance for noise of one."""
        inverse: np.ndarray = np.linalg.pinv(self._ridged(ridge)) / np.outer(self.scale, self.scale)
        return inverse

    def _ridged(self, ridge: float) -> np.ndarray:
        return self.matrix + ridge * np.eye(len(self.scale))


def assembled(sweeps: Sweeps, found: Solved, whole: np.ndarray, jacobian: np.ndarray, b: np.ndarray) -> Normal:
    """Return the normal equations of tracks and further parameters, amplitudes projected out.

    Args:
        sweeps: n sweeps.
        found: their lines with amplitudes.
        whole: what the receiver makes of these (n, N) [LSB].
        jacobian: change of the samples with the frequencies and with the further parameters (n, lines + K, N).
        b: Legendre polynomials of the tracks at the sweeps (n, order).
    """
    jacobian = jacobian * sweeps.used[:, None, :]
    across = np.matmul(jacobian, found.design.conj().swapaxes(1, 2))
    beside = jacobian - np.matmul(np.matmul(across, found.inverse), found.design)
    left = (sweeps.signal - whole) * sweeps.used
    gradient = np.matmul(beside.conj(), left[..., None])[..., 0].real
    normal = np.matmul(beside.conj(), beside.swapaxes(1, 2)).real
    lines = found.phasor.shape[1]
    order, count = b.shape[1], normal.shape[1] - lines
    tt = np.einsum('na,nb,nlm->lamb', b, b, normal[:, :lines, :lines]).reshape(order * lines, order * lines)
    tp = np.einsum('na,nlm->lam', b, normal[:, :lines, lines:]).reshape(order * lines, count)
    pp = normal[:, lines:, lines:].sum(axis=0)
    full = np.block([[tt, tp], [tp.T, pp]])
    right = np.concatenate([np.einsum('na,nl->la', b, gradient[:, :lines]).ravel(), gradient[:, lines:].sum(axis=0)])
    scale = np.sqrt(np.maximum(np.diag(full), 1e-30))
    return Normal(full / np.outer(scale, scale), right, scale)


def refined(s: Sweeps, tracks: Tracks, rounds: int) -> Tracks:
    """Return lines with all frequencies fitted together (Gauss and Newton, amplitudes projected out)."""
    if not len(tracks):
        return tracks
    order = tracks.frequency.shape[1]
    b = basis(s.place, order)
    most = FORWARD.step / s.signal.shape[1]
    found = solve(s, tracks)
    cost = _cost(s, found)
    for _ in range(rounds):
        step = assembled(s, found, found.model, slopes(s, found), b).step(1e-6)
        step = np.clip(step.reshape(len(tracks), order), -most, most)
        for _ in range(FORWARD.halvings):
            trial = Tracks(tracks.frequency + step)
            again = solve(s, trial)
            after = _cost(s, again)
            if after < cost:
                break
            step = 0.25 * step
        else:
            return tracks
        settled = cost - after < FORWARD.settled * cost
        tracks, found, cost = trial, again, after
        if settled:
            break
    return tracks


def _cost(s: Sweeps, found: Solved) -> float:
    return float(np.sum(np.abs((s.signal - found.model)[s.used]) ** 2))


def lines(
    s: Sweeps,
    floor: Noise,
    order: int = 1,
    known: Tracks | None = None,
    most: int = FORWARD.most,
) -> Tracks:
    """Return as many lines as the sweeps demand, whose frequencies have so many coefficients.

    Each begins at the strongest cell, of frequency and of its drift over the sweeps, of what the others leave, if noise
    has such a cell with a small chance; then all are refined together.
    """
    found = known if known is not None else Tracks(np.zeros((0, order)))
    while len(found) < most:
        start = strongest(s, (s.signal - solve(s, found).model) * s.used, floor, order)
        if start is None:
            break
        found = refined(s, Tracks(np.vstack([found.frequency, start])), FORWARD.each)
    return refined(s, found, FORWARD.final)


def strongest(s: Sweeps, rest: np.ndarray, floor: Noise, order: int) -> np.ndarray | None:
    """Return Legendre coefficients (order,) of the strongest line in what is left, None where noise has as strong."""
    count, length = rest.shape
    padded = FORWARD.padding * length
    window = np.hanning(length + 2)[1:-1]
    scale = np.sqrt(np.maximum(np.sum((window * s.used) ** 2, axis=1), 1e-9))
    spectrum = np.abs(np.fft.fft(rest * window / scale[:, None], padded, axis=1)) ** 2
    spectrum /= np.interp(np.arange(padded) / FORWARD.padding, np.arange(length), floor.power)
    bins = np.arange(padded)
    cells = np.minimum(bins, padded - bins)
    usable = cells >= FORWARD.padding * NOISE.lowest
    if not s.iq:
        usable &= bins < padded // 2
    drifts = np.arange(-FORWARD.drift, FORWARD.drift + 1) if order > 1 else np.zeros(1, int)
    best, at = -np.inf, (0, 0)
    for drift in drifts:
        shifts = np.rint(drift * FORWARD.padding / 2.0 * s.place).astype(int)
        total = _shifted_sum(spectrum, shifts) if drift else spectrum.sum(axis=0)
        total = np.where(usable, total, -np.inf)
        own = int(np.argmax(total))
        if total[own] > best * (1.0 + (0.02 if drift else 0.0)):
            best, at = float(total[own]), (own, int(drift))
    chance = float(gammaincc(count, best)) * length * len(drifts)
    if not chance < FORWARD.chance:
        return None
    frequency = at[0] / padded - (at[0] > padded // 2)
    start = np.zeros(order)
    start[0] = frequency
    if order > 1:
        start[1] = at[1] / 2.0 / length
    return start


def _shifted_sum(spectrum: np.ndarray, shifts: np.ndarray) -> np.ndarray:
    """Return the sum of rows, each shifted towards lower bins by so many."""
    total = np.zeros(spectrum.shape[1])
    for shift in np.unique(shifts):
        total += np.roll(spectrum[shifts == shift].sum(axis=0), -shift)
    return total
