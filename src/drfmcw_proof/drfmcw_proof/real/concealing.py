"""Effects added to the samples of real recordings at a known size, without code of simulator or diagnosis."""

import dataclasses
import math

import numpy as np

from drfmcw_diagnosis.recording.dataset import Dataset


@dataclasses.dataclass(frozen=True)
class Concealed:
    """One recording with something added."""

    effect: str
    size: dict[str, float]  # what must come out, in the units of the interface
    words: str
    data: Dataset


def concealments(data: Dataset, seed: int) -> list[Concealed]:
    """Return the recording with one effect each: limits, bursts and, of quadrature samples, imbalances."""
    samples = data.samples_of(0).astype(float)
    found = [_clipped(data, samples, share) for share in (0.02, 0.05, 0.15)]
    if len(samples) >= 16:
        found += [_bursts(data, samples, level, seed) for level in (15.0, 20.0, 30.0)]
    if data.iq and len(samples) >= 16:
        found += [_imbalance(data, samples, *size) for size in ((0.3, 1.5), (1.0, 0.0), (0.0, -4.0))]
    return found


def wrong_settings(data: Dataset) -> list[tuple[str, Dataset]]:
    """Return the recording with a wrong ramp rate, or a wrong start frequency, in words and with these settings."""
    wrong = [(f'ramp rate {error:+.1f} %', {'bandwidth': 1.0 + error / 100.0}) for error in (0.5, 1.0, -2.0, 5.0)]
    wrong += [(f'start frequency {error:+.1f} %', {'start_frequency': 1.0 + error / 100.0}) for error in (-1.0, 2.0)]
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


def _clipped(data: Dataset, samples: np.ndarray, share: float) -> Concealed:
    limit = float(np.quantile(np.abs(samples), 1.0 - share))
    level = 20.0 * math.log10(limit / float(np.median(data.full_scale[0])))
    words = f'limit at {level:.2f} dBFS, {100.0 * share:.0f} % of the samples'
    return Concealed('clipping', {'level': level}, words, _with(data, np.clip(samples, -limit, limit)))


def _bursts(data: Dataset, samples: np.ndarray, above: float, seed: int) -> Concealed:
    """Add white noise to an eighth of every third sweep, so many dB above that of the receiver."""
    rng = np.random.default_rng([seed, int(above)])
    parts = 2 if data.iq else 1
    shaped = samples.reshape(len(samples), -1, parts).copy()
    noise = 1.4826 * float(np.median(np.abs(np.diff(shaped, 4, axis=1)))) / math.sqrt(70.0)
    std = max(noise, 1.0) * 10.0 ** (above / 20.0)
    hit = rng.permutation(len(shaped))[: len(shaped) // 3]
    length = shaped.shape[1] // 8
    for row in hit:
        first = int(rng.integers(shaped.shape[1] // 6, shaped.shape[1] - length))
        shaped[row, first : first + length] += std * rng.standard_normal((length, parts))
    words = f'bursts in {len(hit)} of {len(shaped)} sweeps, {above:.0f} dB above the noise'
    size = {'probability': len(hit) / len(shaped)}
    return Concealed('interference_burst', size, words, _with(data, shaped.reshape(samples.shape)))


def _imbalance(data: Dataset, samples: np.ndarray, gain: float, phase: float) -> Concealed:
    shaped = samples.reshape(len(samples), -1, 2).copy()
    factor, angle = 10.0 ** (gain / 20.0), math.radians(phase)
    shaped[..., 1] = factor * (shaped[..., 1] * math.cos(angle) - shaped[..., 0] * math.sin(angle))
    words = f'Q {gain:+.1f} dB and {phase:+.1f}° off'
    return Concealed('iq_imbalance', {'gain': gain, 'phase': phase}, words, _with(data, shaped.reshape(samples.shape)))
