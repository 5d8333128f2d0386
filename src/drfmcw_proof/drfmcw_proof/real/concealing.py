"""Effects added to the samples of real recordings at a known size, without code of simulator or diagnosis."""

import dataclasses
import math
from typing import Any

import numpy as np

from drfmcw_diagnosis.recording.dataset import Dataset

_SWEEPS = 16  # of a recording from which more than clipping is added


@dataclasses.dataclass(frozen=True)
class Concealed:
    """One recording with something added."""

    effect: str
    size: dict[str, float]  # what must come out, in the units of the interface
    words: str
    data: Dataset
    added: float  # root of the sum of the squares of what was added [LSB]


def concealments(data: Dataset, seed: int) -> list[Concealed]:
    """Return the recording with one effect each: limits, bursts, ripples, echoes; imbalances of quadrature samples."""
    samples = data.samples_of(0).astype(float)
    found = [_clipped(data, samples, share) for share in (0.02, 0.05, 0.15)]
    if len(samples) >= _SWEEPS:
        found += [_bursts(data, samples, level, seed) for level in (15.0, 20.0, 30.0)]
        found += [_ripple(data, samples, 3.3, share) for share in (0.1, 0.3)]
        found += [_echo(data, samples, *size) for size in ((9.0, -12.0), (13.0, -20.0))]
    if data.iq and len(samples) >= _SWEEPS:
        found += [_imbalance(data, samples, *size) for size in ((0.3, 1.5), (1.0, 0.0), (0.0, -4.0))]
    return found


def unchanged(data: Dataset) -> list[tuple[str, Dataset]]:
    """Return controls in words, with nothing added: both halves of the sweeps."""
    count = len(data)
    if count < 2 * _SWEEPS:
        return []
    rows = {'first half': np.arange(count // 2), 'second half': np.arange(count // 2, count)}
    return [(words, _only(data, chosen)) for words, chosen in rows.items()]


def first_sweeps(data: Dataset, most: int) -> Dataset:
    """Return at most so many sweeps of a recording."""
    return data if len(data) <= most else _only(data, np.arange(most))


def wrong_settings(data: Dataset) -> list[tuple[str, Dataset]]:
    """Return the recording with a wrong ramp rate, start frequency or sampling rate, in words and as a dataset."""
    wrong = [(f'ramp rate {error:+.1f} %', {'bandwidth': 1.0 + error / 100.0}) for error in (0.5, 1.0, -2.0, 5.0)]
    wrong += [(f'start frequency {error:+.1f} %', {'start_frequency': 1.0 + error / 100.0}) for error in (-1.0, 2.0)]
    wrong += [(f'sampling rate {error:+.1f} %', {'sample_rate': 1.0 + error / 100.0}) for error in (1.0, -2.0)]
    result = []
    for words, factors in wrong:
        sweeps = tuple(
            tuple(dataclasses.replace(s, **{k: getattr(s, k) * f for k, f in factors.items()}) for s in each)
            for each in data.sweeps
        )
        result.append((words, dataclasses.replace(data, sweeps=sweeps)))
    return result


def swapped(data: Dataset) -> Dataset:
    """Return a quadrature recording with I and Q exchanged."""
    samples = data.samples_of(0)
    return _with(data, samples.reshape(len(samples), -1, 2)[..., ::-1].reshape(samples.shape).astype(float))


def _with(data: Dataset, samples: np.ndarray) -> Dataset:
    codes = np.clip(np.rint(samples), -32768, 32767).astype(np.int16)
    return dataclasses.replace(data, samples=(codes,))


def _only(data: Dataset, rows: np.ndarray) -> Dataset:
    """Return some sweeps of a recording."""
    each: dict[str, Any] = {
        field.name: value[..., rows]
        for field in dataclasses.fields(data)
        if isinstance(value := getattr(data, field.name), np.ndarray)
    }
    return dataclasses.replace(data, samples=(data.samples_of(0)[rows],), **each)


def _concealed(data: Dataset, effect: str, size: dict[str, float], words: str, samples: np.ndarray) -> Concealed:
    """Return the recording with other samples, whose shape may be that of complex ones."""
    changed = _with(data, samples.reshape(data.samples_of(0).shape))
    added = changed.samples_of(0).astype(float) - data.samples_of(0)
    return Concealed(effect, size, words, changed, float(np.sqrt(np.sum(added**2))))


def noise_of(data: Dataset) -> float:
    """Return the standard deviation of the receiver's noise, from fourth differences of neighbouring samples [LSB]."""
    shaped = data.samples_of(0).astype(float).reshape(len(data), -1, 2 if data.iq else 1)
    noise = 1.4826 * float(np.median(np.abs(np.diff(shaped, 4, axis=1)))) / math.sqrt(70.0)
    return max(noise, 1.0 / math.sqrt(12.0))


def _clipped(data: Dataset, samples: np.ndarray, share: float) -> Concealed:
    limit = float(np.quantile(np.abs(samples), 1.0 - share))
    level = 20.0 * math.log10(limit / float(np.median(data.full_scale[0])))
    words = f'limit at {level:.2f} dBFS, {100.0 * share:.0f} % of the samples'
    return _concealed(data, 'clipping', {'level': level}, words, np.clip(samples, -limit, limit))


def _bursts(data: Dataset, samples: np.ndarray, above: float, seed: int) -> Concealed:
    """Add white noise to an eighth of every third sweep, so many dB above that of the receiver."""
    rng = np.random.default_rng([seed, int(above)])
    parts = 2 if data.iq else 1
    shaped = samples.reshape(len(samples), -1, parts).copy()
    std = max(noise_of(data), 1.0) * 10.0 ** (above / 20.0)
    hit = rng.permutation(len(shaped))[: len(shaped) // 3]
    length = shaped.shape[1] // 8
    for row in hit:
        first = int(rng.integers(shaped.shape[1] // 6, shaped.shape[1] - length))
        shaped[row, first : first + length] += std * rng.standard_normal((length, parts))
    words = f'bursts in {len(hit)} of {len(shaped)} sweeps, {above:.0f} dB above the noise'
    size = {'probability': len(hit) / len(shaped)}
    return _concealed(data, 'interference_burst', size, words, shaped)


def _imbalance(data: Dataset, samples: np.ndarray, gain: float, phase: float) -> Concealed:
    shaped = samples.reshape(len(samples), -1, 2).copy()
    factor, angle = 10.0 ** (gain / 20.0), math.radians(phase)
    shaped[..., 1] = factor * (shaped[..., 1] * math.cos(angle) - shaped[..., 0] * math.sin(angle))
    words = f'Q {gain:+.1f} dB and {phase:+.1f}° off'
    return _concealed(data, 'iq_imbalance', {'gain': gain, 'phase': phase}, words, shaped)


def _ripple(data: Dataset, samples: np.ndarray, periods: float, samples_off: float) -> Concealed:
    """Let the ramp ripple: where its frequency is what it should be later, so is the IF, whatever the delays.

    Args:
        data: recording.
        samples: of its sweeps.
        periods: of the ripple in a sweep.
        samples_off: peak of the time by which the ramp is early, over the period of the fastest line.
    """
    signal = _complex(data, samples)
    count, (sweep,) = signal.shape[1], data.sweeps[0]
    at = np.arange(count)
    early = samples_off / _fastest(signal) * np.sin(2.0 * np.pi * periods * at / count + 0.7)
    rate = periods / count * sweep.sample_rate
    deviation = samples_off / _fastest(signal) / sweep.sample_rate * abs(sweep.chirp_rate)
    words = f'ripple of {deviation:.3g} Hz, {periods:.1f} periods in a sweep'
    size = {'rate': rate, 'deviation': deviation}
    return _concealed(data, 'sweep_ripple', size, words, _parts(data, _earlier(signal, early)))


def _echo(data: Dataset, samples: np.ndarray, cells: float, level: float) -> Concealed:
    """Add a copy of all that was received, delayed by so many resolution cells, at a level [dB]."""
    signal = _complex(data, samples)
    count, (sweep,) = signal.shape[1], data.sweeps[0]
    moving = signal - signal.mean(axis=1, keepdims=True)
    if not data.iq:
        moving = _analytic(moving)
    delay = cells * sweep.sample_rate / count / sweep.chirp_rate
    turn = np.exp(2j * np.pi * (cells * np.arange(count) / count + sweep.start_frequency * delay))
    copy = 10.0 ** (level / 20.0) * moving * turn
    words = f'a copy of all lines {delay * 299792458.0:.3g} m farther, {level:.0f} dB'
    size = {'path': delay * 299792458.0, 'level': level}
    return _concealed(data, 'echo', size, words, _parts(data, signal + (copy if data.iq else copy.real)))


def _complex(data: Dataset, samples: np.ndarray) -> np.ndarray:
    return samples[:, ::2] + 1j * samples[:, 1::2] if data.iq else samples


def _parts(data: Dataset, signal: np.ndarray) -> np.ndarray:
    return np.stack([signal.real, signal.imag], axis=-1) if data.iq else signal


def _analytic(signal: np.ndarray) -> np.ndarray:
    spectrum = np.fft.fft(signal, axis=1)
    half = signal.shape[1] // 2
    spectrum[:, 1:half] *= 2.0
    spectrum[:, half + 1 :] = 0.0
    values: np.ndarray = np.fft.ifft(spectrum, axis=1)
    return values


def _fastest(signal: np.ndarray) -> float:
    """Return the frequency of the strongest line that is not near 0 Hz [1 / sample]."""
    count = signal.shape[1]
    power = np.mean(np.abs(np.fft.fft(signal * np.hanning(count), axis=1)) ** 2, axis=0)
    power[: max(count // 64, 4)] = 0.0
    return float(max(np.argmax(power[: count // 2]), 1) / count)


def _earlier(signal: np.ndarray, by: np.ndarray) -> np.ndarray:
    """Return sweeps (n, N) as they are `by` (N,) samples later: band-limited, continued by reflection."""
    count, finer = signal.shape[1], 8
    before = 2.0 * signal[:, :1] - signal[:, 1:][:, ::-1]
    after = 2.0 * signal[:, -1:] - signal[:, :-1][:, ::-1]
    whole = np.concatenate([before, signal, after], axis=1)
    length = whole.shape[1]
    spectrum, dense = np.fft.fft(whole, axis=1), np.zeros((len(whole), finer * length), complex)
    half = (length + 1) // 2
    dense[:, :half], dense[:, half - length :] = spectrum[:, :half], spectrum[:, half:]
    fine = np.fft.ifft(dense, axis=1) * finer
    at = (np.arange(count) + count - 1 + by) * finer
    below = at.astype(int)
    result: np.ndarray = fine[:, below] * (1.0 - (at - below)) + fine[:, below + 1] * (at - below)
    return result if np.iscomplexobj(signal) else result.real
