"""The faults of the campaign: what each does to the sweeps of a pair, in sizes that occur."""

import dataclasses
from collections.abc import Callable
from typing import Any

import numpy as np
from scipy.signal import hilbert

from drfmcw_physics.constants import SPEED_OF_LIGHT

_CHIRP_RATE, _SAMPLE_RATE = 150e6 / 1e-3, 2.048e6  # of the campaign's scenario [Hz/s, Hz]
Samples = tuple[np.ndarray, np.ndarray]


@dataclasses.dataclass(frozen=True)
class Fault:
    """A fault with one of its sizes. It acts from some sweep on; what comes before is clean."""

    name: str
    size: str
    effects: tuple[dict[str, Any], ...] = ()  # of the scenario
    samples: Callable[[Samples, np.random.Generator], Samples] | None = None  # of the sweeps that the fault hits
    farther: float = 0.0  # the signal comes over a path longer by this [m]
    first_stamp: int = 0  # sweeps by which the stamps of station 2 are off
    jitter: tuple[float, float] = (0.0, 0.0)  # delay of a station's results on their way, from and to [s]
    weather: tuple[str, float] | None = None  # topic and value of a reading
    said_mode: int | None = None  # what both stations say, whatever they do
    share: float = 1.0  # of the sweeps that are hit
    unlocked: bool = False  # the second station's status says so


def _zero(samples: Samples, _: np.random.Generator) -> Samples:
    return samples[0], np.zeros_like(samples[1])


def _constant(samples: Samples, _: np.random.Generator) -> Samples:
    return np.full_like(samples[0], 77), samples[1]


def _silent(samples: Samples, generator: np.random.Generator) -> Samples:
    """Noise alone at station 2, as strong as between the first codes of its records without a line."""
    noise = generator.normal(0.0, 22.0, samples[1].shape)
    return samples[0], np.rint(noise).astype(np.int16)


def _repeated(samples: Samples, _: np.random.Generator) -> Samples:
    return samples[0], np.broadcast_to(samples[1][:1], samples[1].shape).copy()


def _both_repeated(samples: Samples, _: np.random.Generator) -> Samples:
    return tuple(np.broadcast_to(s[:1], s.shape).copy() for s in samples)  # type: ignore[return-value]


def _neighbour(samples: Samples, _: np.random.Generator) -> Samples:
    return samples[0], np.roll(samples[1], -1, axis=0)


def _dropped(count: int) -> Callable[[Samples, np.random.Generator], Samples]:
    """Leave out `count` samples somewhere in station 1's sweep; zeros fill its end."""

    def apply(samples: Samples, generator: np.random.Generator) -> Samples:
        changed = samples[0].copy()
        for row in changed:
            at = int(generator.integers(100, len(row) - 100))
            row[at : len(row) - count] = row[at + count :].copy()
            row[len(row) - count :] = 0
        return changed, samples[1]

    return apply


def _inserted(count: int) -> Callable[[Samples, np.random.Generator], Samples]:
    """Repeat `count` samples in the middle of station 1's sweep; its end is lost."""

    def apply(samples: Samples, _: np.random.Generator) -> Samples:
        changed = samples[0].copy()
        middle = changed.shape[1] // 2
        changed[:, middle + count :] = samples[0][:, middle : changed.shape[1] - count]
        return changed, samples[1]

    return apply


def _rising_echo(excess: float, level: float) -> Callable[[Samples, np.random.Generator], Samples]:
    """Add an echo whose path is longer by `excess` [m], and which rises from -50 dB to `level` [dB], in dB linearly.

    The lines of both stations move apart by k times its delay, at the sweep of Table 1.
    """

    def apply(samples: Samples, _: np.random.Generator) -> Samples:
        shift = _CHIRP_RATE * excess / SPEED_OF_LIGHT * np.arange(samples[0].shape[1]) / _SAMPLE_RATE
        weight = 10.0 ** (np.linspace(-50.0, level, len(samples[0])) / 20.0)[:, None]
        changed = []
        for own, sign in zip(samples, (1.0, -1.0), strict=True):
            echo = np.real(hilbert(own, axis=1) * np.exp(2j * np.pi * sign * shift))
            changed.append(np.rint(np.clip(own + weight * echo, -32768, 32767)).astype(np.int16))
        return changed[0], changed[1]

    return apply


def _shifted(count: int) -> Callable[[Samples, np.random.Generator], Samples]:
    """Take every sample of station 1 `count` samples late, early where that is negative."""
    return lambda samples, _: (np.roll(samples[0], -count, axis=1), samples[1])


def _spliced(samples: Samples, generator: np.random.Generator) -> Samples:
    """Join the beginning of a sweep of station 1 to the end of the next one."""
    changed = samples[0].copy()
    following = np.roll(samples[0], -1, axis=0)
    for row, after in zip(changed, following, strict=True):
        at = int(generator.integers(200, len(row) - 200))
        row[at:] = after[at:]
    return changed, samples[1]


def _effect(name: str, **parameters: Any) -> dict[str, Any]:
    return {'effect': name, **parameters}


def faults() -> list[Fault]:
    """Return every fault in every size; the first is none at all."""
    found = [Fault('none', 'clean')]
    found += [Fault('all-zero sweep', 'every 10th', samples=_zero, share=0.1)]
    found += [Fault('constant sweep', 'every 10th', samples=_constant, share=0.1)]
    found += [Fault('silent peer', 'noise at station 2', samples=_silent)]
    found += [
        Fault('fade', f'{loss} dB', effects=(_effect('amplitude_loss', loss=loss),)) for loss in (20.0, 26.0, 32.0)
    ]
    found += [
        Fault(
            'interference bursts',
            f'{level} dBFS, 20 us',
            effects=(_effect('interference_burst', station='slave', probability=1.0, level=level, duration=20e-6),),
        )
        for level in (-40.0, -20.0)
    ]
    found += [
        Fault(
            'spur',
            f'{level} dBFS',
            effects=(_effect('spur', station='master', frequency=333e3, level=level),),
        )
        for level in (-30.0, -20.0, -10.0)
    ]
    found += [
        Fault(
            'reference clock jump',
            f'{jump} ppm',
            effects=(_effect('reference_clock_offset', station='slave', deviation=jump),),
        )
        for jump in (5.0, 20.0, -20.0)
    ]
    found += [
        Fault('sweep ids off by one', 'stamps right', samples=_neighbour, first_stamp=1),
        Fault('sweep ids off by one', 'stamps wrong too', samples=_neighbour),
        Fault('repeated buffer', 'one station', samples=_repeated),
        Fault('repeated buffer', 'both stations', samples=_both_repeated),
        Fault('samples dropped', '1', samples=_dropped(1)),
        Fault('samples dropped', '64', samples=_dropped(64)),
        Fault('samples inserted', '16', samples=_inserted(16)),
        Fault('samples shifted', '8', samples=_shifted(8)),
        Fault('samples shifted', '-8', samples=_shifted(-8)),
        Fault('samples spliced', 'two sweeps', samples=_spliced),
        Fault('rising echo', '0.6 m longer, to -10 dB', samples=_rising_echo(0.6, -10.0)),
        Fault('rising echo', '0.6 m longer, to 6 dB', samples=_rising_echo(0.6, 6.0)),
        Fault('rising echo', '2 m longer, to 6 dB', samples=_rising_echo(2.0, 6.0)),
        Fault('direct path blocked', 'echo 10 m longer', farther=10.0),
        Fault('wrong mode', 'LD said, SD done', said_mode=1),
        Fault('weather units', 'humidity 75', weather=('/site/humidity', 75.0)),
        Fault('weather units', 'pressure 1013 (hPa)', weather=('/site/pressure', 1013.0)),
        Fault('weather units', 'temperature 288 (K)', weather=('/site/temperature', 288.0)),
        Fault('weather units', 'temperature -273.15', weather=('/site/temperature', -273.15)),
        Fault('reordered link', '100 to 300 ms', jitter=(0.1, 0.3)),
        Fault('PLL unlocked', 'status bit', unlocked=True),
    ]
    return found
