"""Side-bands of both stations' lines: their covariance in the noise of a pair, and those of relative changes.

At each offset f > 0 from the lines, the relative changes g_i of both signals have the side-bands G_1(f), G_1*(-f),
G_2(f) and G_2*(-f).
"""

import math
from collections.abc import Sequence

import numpy as np

from ..generator.model import FIRST, SECOND, SPEED_OF_LIGHT, Scene
from ..generator.phase_noise import phase_noise_density

_ABSENT = 1.0  # [1/Hz] noise density of a side-band that a real IF does not have
AMPLITUDES, PHASES, FLIGHT = (0, 1), (2, 3), 5
"""Where `nuisances` has what each sweep has of its own."""


def noise_covariance(
    scene: Scene,
    row: int,
    noisy: Scene,
    floors: Sequence[float] = (1.0, 1.0),
    skirts: Sequence[np.ndarray | float] = (1.0, 1.0),
) -> tuple[np.ndarray, np.ndarray]:
    """Return the covariance of both stations' side-bands at one row, and which of them exist.

    Lines stand where they are in `scene`, with the noise of `noisy`: of it, each station's floor and each oscillator's
    phase noise [samples / 2] is so many times as strong.

    At each offset f > 0 from the lines, the relative changes g_i of the signals have the side-bands G_1(f), G_1*(-f),
    G_2(f), G_2*(-f): covariance [samples / 2, 4, 4], existence [samples / 2, 4].
    """
    c = scene.condition
    count, rate = c.sample_count, c.sample_rate
    offset = np.arange(count // 2) * (rate / count)
    one = np.array([row])
    flight, start = flight_time(scene, one)[0], scene.start_delay[row]
    density = [skirts[s] * phase_noise_density(offset, *noisy.oscillators[s]) for s in (FIRST, SECOND)]
    omega = 2.0 * math.pi * offset
    cross = -density[0] * np.exp(1j * omega * (flight - start)) - density[1] * np.exp(-1j * omega * (flight + start))
    phase = np.empty((count // 2, 2, 2), complex)
    phase[:, 0, 0] = phase[:, 1, 1] = density[0] + density[1]
    phase[:, 0, 1], phase[:, 1, 0] = cross, np.conj(cross)
    bands = np.zeros((4, 2), complex)  # of the phase noise of each station
    bands[0, 0], bands[1, 0], bands[2, 1], bands[3, 1] = 1j, -1j, 1j, -1j
    relative = np.empty((count // 2, 4), complex)  # response of the IF path, relative to that at the line
    thermal = np.empty((count // 2, 4))
    present = np.empty((count // 2, 4), bool)
    for s in (FIRST, SECOND):
        line = signed_line(scene, s, one)[0]
        alike = np.flatnonzero(scene.setting == scene.setting[row])  # each has its own amplitude
        density_here = floors[s] * noisy.noise_std(s)[row] ** 2 / rate / np.mean(scene.amplitude(s, alike) ** 2)
        for i, side in ((2 * s, 1.0), (2 * s + 1, -1.0)):
            frequency = np.sign(line) * (line + side * offset)
            present[:, i] = (frequency > -0.5 * rate / count) & (frequency < 0.5 * rate)
            gain = np.ones(count // 2, complex)
            for response in noisy.responses[s]:
                gain = gain * response(np.abs(frequency)) / response(abs(line))
            relative[:, i] = gain if side > 0 else np.conj(gain)
            thermal[:, i] = 4.0 * density_here + _folded(noisy, np.abs(frequency), abs(line))
    covariance = np.einsum('ij,fjk,lk->fil', bands, phase, np.conj(bands))
    covariance[:, np.arange(4), np.arange(4)] += thermal
    covariance *= relative[:, :, None] * np.conj(relative[:, None, :])
    both = present[:, :, None] & present[:, None, :]
    covariance = np.where(both, covariance, 0.0)
    covariance[:, np.arange(4), np.arange(4)] += np.where(present, 0.0, _ABSENT)
    return covariance, present


def _folded(scene: Scene, frequency: np.ndarray, line: float) -> np.ndarray:
    """Return the density at frequencies of a real IF of those side-bands that fold back at zero and at Nyquist."""
    rate = scene.condition.sample_rate
    result = np.zeros(frequency.shape)
    for offset in (frequency + line, rate - frequency - line):
        density = sum(phase_noise_density(np.abs(offset), *o) for o in scene.oscillators)
        result += np.where(np.abs(offset) <= 0.5 * rate, density, 0.0)
    return result


def flight_time(scene: Scene, rows: np.ndarray) -> np.ndarray:
    """Return how long the signals of sweeps travel, hardware included [rows] [s]."""
    far = scene.range_at(rows, scene.time[rows])
    return scene.delay[rows] + (1.0 + 1e-6 * scene.refractivity[rows]) / SPEED_OF_LIGHT * far


def signed_line(scene: Scene, station: int, rows: np.ndarray) -> np.ndarray:
    """Return the signed IF of a station's line [rows] [Hz]."""
    c = scene.condition
    start = scene.start_delay[rows] * (1.0 if station == FIRST else -1.0)
    apart = scene.alpha[station, rows] - scene.alpha[1 - station, rows]
    return c.chirp_rate * (flight_time(scene, rows) + start) + c.start_frequency * apart


def side_bands(g: Sequence[np.ndarray]) -> np.ndarray:
    """Return the side-bands [..., samples / 2, 4] of relative changes [..., samples] of both stations."""
    result = []
    for one in g:
        spectrum = np.fft.fft(one)
        half = one.shape[-1] // 2
        below = np.conj(np.roll(spectrum[..., ::-1], 1, axis=-1)[..., :half])
        result += [spectrum[..., :half], below]
    return np.stack(result, axis=-1)


def nuisances(scene: Scene, supports: np.ndarray) -> np.ndarray:
    """Return the side-bands of what each sweep has of its own [rows, 6, samples / 2, 4].

    Of both amplitudes, of both phases, of the start delay and of the time of flight: see `AMPLITUDES`, `PHASES` and
    `FLIGHT`, their places.

    Args:
        scene: conditions of the sweeps.
        supports: bool [2, rows, samples], where signals are on.
    """
    c = scene.condition
    count = c.sample_count
    slope = 2j * math.pi * c.chirp_rate * (np.arange(count) - 0.5 * count) / c.sample_rate
    on = supports.astype(complex)
    nothing = np.zeros_like(on[0])
    pairs = [
        (on[0], nothing),
        (nothing, on[1]),
        (1j * on[0], nothing),
        (nothing, 1j * on[1]),
        (slope * on[0], -slope * on[1]),
        (slope * on[0], slope * on[1]),
    ]
    return np.stack([side_bands(p) for p in pairs], axis=1)


def whitened(nominal_: np.ndarray, *others: np.ndarray) -> list[np.ndarray]:
    """Return covariances [samples / 2, 4, 4] in units of one, which is the identity then."""
    root = np.linalg.inv(np.linalg.cholesky(nominal_))
    return [root @ other @ np.conj(np.swapaxes(root, 1, 2)) for other in others]
