"""What the simulator's effects do to the lines of a scene, and to the samples that the receiver makes of them."""

from collections.abc import Sequence

import numpy as np

from drfmcw_physics.sweep import SweepSettings
from drfmcw_sim.effects import ActsOn, Effect
from drfmcw_sim.measurements import Measurements, Path, Station
from drfmcw_sim.synthesis.signal_model import synthesise

from ..material import Material
from .limits import FORWARD


class Simulated:
    """Effects on a scene's lines, each of which is a path of the delay that its frequency has on a straight ramp."""

    def __init__(self, m: Material, first: int, count: int, effects: Sequence[Effect] = ()) -> None:
        """Remember the radar, the samples (`first` and `count`) that are described, and effects."""
        self.radar = m
        self.span = slice(first, first + count)
        self.effects = tuple(effects)
        samples = ActsOn.SAMPLES
        self.shaping = [e for e in self.effects if samples not in e.acts_on]
        self.receiving = sorted((e for e in self.effects if samples in e.acts_on), key=lambda e: e.stage)
        self.rate = m.bandwidth / m.duration  # of the ramp [Hz/s]

    def factors(self, frequency: np.ndarray) -> np.ndarray:
        """Return the factors (n, L, N) that effects put to waves of lines at frequencies (n, L) [1 / sample].

        What they do to a line's phase is linear in its delay over the little that a track moves.
        """
        count = self.span.stop - self.span.start
        if not self.shaping or not frequency.shape[1]:
            return np.ones((*frequency.shape, count))
        middle = np.mean(frequency, axis=0)
        at = self._factor(middle)
        if np.ptp(frequency, axis=0).max() * count < FORWARD.still_there:
            return np.broadcast_to(at, (*frequency.shape, count))
        apart = FORWARD.apart / count
        turned = np.angle(self._factor(middle + apart) * at.conj()) / apart
        return at * np.exp(1j * turned * (frequency - middle)[..., None])

    def _factor(self, frequency: np.ndarray) -> np.ndarray:
        """Return the factors (L, N) of lines at frequencies (L,) [1 / sample]: simulated with effects over without."""
        hertz = frequency * self.radar.rate
        delay = np.abs(hertz / self.rate)
        with_them, without = (
            synthesise(self._measurements(delay), 0, effects, noise=False, quantised=False)[0][:, self.span]
            for effects in (self.shaping, ())
        )
        over, under = (x[..., 0].astype(float) + 1j * x[..., 1] for x in (with_them, without))
        ratio = np.where(np.abs(under) > 0.0, over / np.where(np.abs(under) > 0.0, under, 1.0), 1.0)
        return np.where((hertz * self.rate < 0.0)[:, None], ratio.conj(), ratio)

    def received(self, signal: np.ndarray) -> np.ndarray:
        """Return what the receiver's effects make of the sum of all lines (n, N) [LSB]."""
        if not self.receiving:
            return signal
        count = len(signal)
        whole = np.zeros((count, self.span.stop), signal.dtype)
        whole[:, self.span] = signal
        m = self._measurements(np.zeros(count), self.radar.iq)
        heard = np.stack([whole.real, whole.imag], axis=-1) if self.radar.iq else whole
        heard = heard.astype(np.float32)
        for effect in self.receiving:
            effect.receive(heard, m.stations[0], m, _nothing_random)
        result = heard[:, self.span].astype(float)
        return result[..., 0] + 1j * result[..., 1] if self.radar.iq else result

    def _measurements(self, delay: np.ndarray, iq: bool = True) -> Measurements:
        """Return one measurement per delay (n,) [s], over one path of half of full scale."""
        m, count = self.radar, len(delay)
        zeros, ones = np.zeros(count), np.ones(count)
        sweep = SweepSettings(
            station=m.station,
            peer=m.station,
            start_frequency=m.start_frequency,
            bandwidth=m.bandwidth,
            ramp_duration=m.duration,
            start_delay=0.0,
            sample_rate=m.rate,
            sample_count=max(self.span.stop, 16),
            full_scale_power=0.0,
        )
        station = Station(
            sweep=sweep,
            alpha=ones.copy(),
            sample_clock=ones.copy(),
            received_power=zeros - 6.0,
            noise_density=zeros - 200.0,
            phase_noise=None,
            temperature=zeros + 25.0,
            full_scale=m.full_scale,
            iq=iq,
        )
        path = Path(delay.astype(float), zeros.copy(), zeros.copy(), ones.copy())
        return Measurements(
            (station,),
            np.arange(count),
            zeros.copy(),
            zeros.copy(),
            zeros.copy(),
            zeros.copy(),
            np.zeros((1, count)),
            [path],
        )


def _nothing_random() -> list[np.random.Generator]:
    raise TypeError('a random effect has no template')
