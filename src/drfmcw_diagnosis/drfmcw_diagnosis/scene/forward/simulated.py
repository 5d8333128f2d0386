"""What the simulator's effects do to the lines of a scene, and to the samples that the receiver makes of them."""

import functools
from collections.abc import Sequence

import numpy as np

from drfmcw_physics.sweep import SweepSettings
from drfmcw_sim.effects import ActsOn, Effect
from drfmcw_sim.measurements import Measurements, Path, Station
from drfmcw_sim.synthesis.signal_model import synthesise

from ..material import Material
from .limits import FORWARD


class Lines:
    """Lines of a scene, each of which is a path of the delay that its frequency has on a straight ramp.

    Attributes:
        radar: the sweeps of the scene.
        span: the samples of a sweep that are described.
        rate: of the ramp [Hz/s].
    """

    def __init__(self, m: Material, first: int, count: int) -> None:
        """Remember the radar and the samples (`first` and `count`) that are described."""
        self.radar = m
        self.span = slice(first, first + count)
        self.rate = m.bandwidth / m.duration

    def shaped(self, frequency: np.ndarray, effects: Sequence[Effect]) -> np.ndarray:
        """Return the factors (L, N) that effects put to lines at frequencies (L,) [1 / sample], by simulation."""
        hertz = frequency * self.radar.rate
        delay = np.abs(hertz / self.rate)
        over, under = self._simulated(delay, effects), self._without_effects(delay.tobytes())
        ratio = np.where(np.abs(under) > 0.0, over / np.where(np.abs(under) > 0.0, under, 1.0), 1.0)
        return np.where((hertz * self.rate < 0.0)[:, None], ratio.conj(), ratio)

    @functools.lru_cache(maxsize=FORWARD.straight)  # noqa: B019 few are kept, and each scene makes its own anew
    def _without_effects(self, delay: bytes) -> np.ndarray:
        """Return waves without effects (L, N): the same for all effects that are tried on them."""
        return self._simulated(np.frombuffer(delay), ())

    def _simulated(self, delay: np.ndarray, effects: Sequence[Effect]) -> np.ndarray:
        """Return waves (L, N) that come with delays (L,) [s]."""
        m = self.measurements(delay)
        heard = synthesise(m, 0, effects, noise=False, quantised=False)[0][:, self.span]
        return heard[..., 0].astype(float) + 1j * heard[..., 1]

    def measurements(self, delay: np.ndarray, iq: bool = True) -> Measurements:
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


class Simulated:
    """What effects do to the lines of a scene, and to the samples that the receiver makes of them."""

    def __init__(self, lines: Lines, effects: Sequence[Effect] = ()) -> None:
        """Remember the lines and the effects."""
        self.lines = lines
        samples = ActsOn.SAMPLES
        self.shaping = [e for e in effects if samples not in e.acts_on]
        self.receiving = sorted((e for e in effects if samples in e.acts_on), key=lambda e: e.stage)

    def factors(self, frequency: np.ndarray) -> np.ndarray:
        """Return the factors (n, L, N) that effects put to waves of lines at frequencies (n, L) [1 / sample].

        What they do to a line's phase is linear in its delay over the little that a track moves.
        """
        count = self.lines.span.stop - self.lines.span.start
        if not self.shaping or not frequency.shape[1]:
            return np.ones((*frequency.shape, count))
        middle = np.mean(frequency, axis=0)
        if np.ptp(frequency, axis=0).max() * count < FORWARD.still_there:
            return np.broadcast_to(self.lines.shaped(middle, self.shaping), (*frequency.shape, count))
        apart = FORWARD.apart / count
        at, beside = np.split(self.lines.shaped(np.concatenate([middle, middle + apart]), self.shaping), 2)
        turned = np.angle(beside * at.conj()) / apart
        turn = turned * (frequency - middle)[..., None]
        factors = np.empty(turn.shape, complex)
        np.cos(turn, out=factors.real)
        np.sin(turn, out=factors.imag)
        factors *= at
        return factors

    def received(self, signal: np.ndarray) -> np.ndarray:
        """Return what the receiver's effects make of the sum of all lines (n, N) [LSB]."""
        if not self.receiving:
            return signal
        count, radar, span = len(signal), self.lines.radar, self.lines.span
        whole = np.zeros((count, span.stop), signal.dtype)
        whole[:, span] = signal
        m = self.lines.measurements(np.zeros(count), radar.iq)
        heard = np.stack([whole.real, whole.imag], axis=-1) if radar.iq else whole
        heard = heard.astype(np.float32)
        for effect in self.receiving:
            effect.receive(heard, m.stations[0], m, _nothing_random)
        result = heard[:, span].astype(float)
        return result[..., 0] + 1j * result[..., 1] if radar.iq else result


def _nothing_random() -> list[np.random.Generator]:
    raise TypeError('a random effect has no template')
