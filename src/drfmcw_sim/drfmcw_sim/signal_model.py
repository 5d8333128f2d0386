"""IF signals of a pair of stations, sample by sample from the phases of both chirps (eqs. 14-17 and 22).

Station i transmits phi_i(u) = 2 pi (alpha_i f_0 u + alpha_i^2 k u^2 / 2) + phi_0i + phi_PN,i while
0 <= u <= T_sw/alpha_i, u counted from its own sweep start. A receiver a mixes its own chirp with
what arrives from station b:

    D_a(u) = phi_a(u) - phi_b(v),   v = u - d(u),   d(u) = (s_b - s_a) + tau(s_a + u),

s the sweep starts (s_1 = 0, s_2 = T_off), tau(t) the delay of the whole path of what arrives at time t. The real IF is
cos D_a; a quadrature receiver gives I = cos D_a, Q = sin D_a (own minus received). Differences are formed analytically,
as polynomials in u, so that no 1e7 rad phases are ever subtracted.
"""

import dataclasses
from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np

from drfmcw_physics.phase_noise import PhaseNoise
from drfmcw_physics.sweep import SweepSettings

from . import oscillator
from .random_streams import Purpose, stream

if TYPE_CHECKING:
    from .effects import Effect

_CHUNK = 8  # sweeps worked on at once: what fits the processor's cache
_NEGLIGIBLE_DRIFT = 1e-3  # samples between two ADC clocks within a record, for phase noise only


@dataclasses.dataclass
class Station:
    """True state of one station in a batch of n measurements; effects may change the arrays."""

    sweep: SweepSettings
    alpha: np.ndarray  # [n] reference / nominal
    sample_clock: np.ndarray  # [n] ADC clock / nominal
    received_power: np.ndarray  # [n] of the direct path at the antenna port [dBm]
    noise_density: np.ndarray  # [n] at the antenna port [dBm/Hz]
    phase_noise: PhaseNoise | None
    temperature: np.ndarray  # [n] board [degC]
    calibration_temperature: float = 25.0  # [degC]
    full_scale: float = 8192.0  # [LSB]
    iq: bool = False

    @property
    def name(self) -> str:
        """The station's name."""
        return self.sweep.station

    def amplitude(self, power: np.ndarray) -> np.ndarray:
        """Return the amplitude [LSB] of a sine of `power` [dBm] at the antenna port."""
        return self.full_scale * 10.0 ** ((power - self.sweep.full_scale_power) / 20.0)

    def noise_std(self) -> np.ndarray:
        """Return the standard deviation of the additive noise in each real or I or Q sample [LSB].

        The density spreads over f_s/2 of a real IF, over f_s of a quadrature one; both then have the same noise power
        per line power in a bin.
        """
        bandwidth = self.sweep.sample_rate * (1.0 if self.iq else 0.5)
        return self.amplitude(self.noise_density + 10.0 * np.log10(bandwidth)) / np.sqrt(2.0)


@dataclasses.dataclass
class Path:
    """One propagation path: tau(t) = delay + rate t + acceleration t^2 / 2, t since station 1's sweep start."""

    delay: np.ndarray  # [n] of the whole path, hardware and air [s]
    rate: np.ndarray  # [n] [s/s]
    acceleration: np.ndarray  # [n] [s/s^2]
    amplitude: np.ndarray  # [n] relative to the direct path, negative where the sign is reversed [1]


@dataclasses.dataclass
class Measurements:
    """Everything that determines the IF signals of n measurements of one pair with one set of sweep settings."""

    stations: tuple[Station, ...]  # first and second, or the one station that hears itself
    sweep_id: np.ndarray  # [n]
    time: np.ndarray  # [n] station 1's sweep start since the scenario's start [s]
    range: np.ndarray  # [n] true antenna distance at that time [m]
    velocity: np.ndarray  # [n] [m/s]
    start_delay: np.ndarray  # [n] true T_off [s]
    initial_phase: np.ndarray  # [stations, n] phi_0 [turns]
    paths: list[Path]  # the direct one first
    start_delay_jitter: float = 0.0  # standard deviation from sweep to sweep [s]
    amplitude_scatter: float = 0.0  # standard deviation from sweep to sweep [dB]
    refractive_index: np.ndarray | float = 1.0  # [n] of the air on the path
    setting: np.ndarray | int = 0  # [n] number of the distance at which the crane stands

    def __len__(self) -> int:
        """Return the number of measurements."""
        return len(self.sweep_id)

    def rows(self, rows: slice) -> 'Measurements':
        """Return a copy of some of the measurements."""
        stations = tuple(
            dataclasses.replace(
                s,
                alpha=s.alpha[rows].copy(),
                sample_clock=s.sample_clock[rows].copy(),
                received_power=s.received_power[rows].copy(),
                noise_density=s.noise_density[rows].copy(),
                temperature=s.temperature[rows].copy(),
            )
            for s in self.stations
        )
        paths = [Path(*(getattr(p, f.name)[rows].copy() for f in dataclasses.fields(Path))) for p in self.paths]
        return dataclasses.replace(
            self,
            stations=stations,
            paths=paths,
            initial_phase=self.initial_phase[:, rows].copy(),
            **{
                name: np.broadcast_to(getattr(self, name), len(self))[rows].copy()
                for name in ('sweep_id', 'time', 'range', 'velocity', 'start_delay', 'refractive_index', 'setting')
            },
        )


@dataclasses.dataclass(frozen=True)
class Geometry:
    """Where the peer's chirp is heard: v = -offset + (1 - rate) u - acceleration u^2 / 2; arrays [n]."""

    offset: np.ndarray  # d(0) [s]
    rate: np.ndarray  # [s/s]
    acceleration: np.ndarray  # [s/s^2]
    step: np.ndarray  # true time between the receiver's samples [s]

    def peer_time(self, count: int) -> np.ndarray:
        """Return v [n, count], the peer's own time whose chirp each sample mixes with [s]."""
        u = np.arange(count) * self.step[:, None]
        return u * (1.0 - self.rate[:, None]) - self.offset[:, None] - 0.5 * self.acceleration[:, None] * u * u

    def crossing(self, peer_time: np.ndarray | float) -> np.ndarray:
        """Return the receiver's time u at which the peer's chirp of time v arrives [n] [s]."""
        u = (self.offset + peer_time) / (1.0 - self.rate)
        for _ in range(2):  # the acceleration moves it by picoseconds
            u = (self.offset + peer_time + 0.5 * self.acceleration * u * u) / (1.0 - self.rate)
        return u


def geometry(m: Measurements, receiver: int, path: Path) -> Geometry:
    """Return where station `receiver` (0 first, 1 second) hears the other one's chirp over `path`."""
    own = m.stations[receiver]
    step = 1.0 / (own.sweep.sample_rate * own.sample_clock)
    if len(m.stations) == 1:
        start, between = np.zeros(len(m)), np.zeros(len(m))
    elif receiver == 0:
        start, between = np.zeros(len(m)), m.start_delay
    else:
        start, between = m.start_delay, -m.start_delay
    offset = between + path.delay + path.rate * start + 0.5 * path.acceleration * start * start
    return Geometry(offset, path.rate + path.acceleration * start, path.acceleration, step)


def if_turns(m: Measurements, receiver: int, path: Path) -> np.ndarray:
    """Return the noise-free IF phase D_a / 2 pi of every sample, reduced to +-1/2 turn, float64 [n, samples].

    Args:
        m: measurements.
        receiver: 0 first station, 1 second.
        path: over which the peer is heard.
    """
    own, peer = m.stations[receiver], m.stations[1 - receiver if len(m.stations) == 2 else 0]
    g = geometry(m, receiver, path)
    d, r, c, h = g.offset, g.rate, g.acceleration, g.step
    f_own, f_peer = own.alpha * own.sweep.start_frequency, peer.alpha * peer.sweep.start_frequency
    k_own, k_peer = own.alpha**2 * own.sweep.chirp_rate, peer.alpha**2 * peer.sweep.chirp_rate
    # D_a / 2 pi = f_own u + k_own u^2/2 - f_peer v - k_peer v^2/2, multiplied out; u^4 is 1e-19 turns and left out
    c0 = f_peer * d - 0.5 * k_peer * d * d
    if len(m.stations) == 2:
        c0 = c0 + m.initial_phase[receiver] - m.initial_phase[1 - receiver]
    c1 = (f_own - f_peer) + f_peer * r + k_peer * d * (1.0 - r)
    c2 = 0.5 * (k_own - k_peer) + 0.5 * f_peer * c + 0.5 * k_peer * (2.0 * r - r * r - d * c)
    c3 = 0.5 * k_peer * (1.0 - r) * c
    n = np.arange(own.sweep.sample_count, dtype=np.float64)
    turns = np.multiply.outer(c3 * h**3, n) if np.any(c3) else np.zeros((len(m), len(n)))
    turns += (c2 * h * h)[:, None]
    turns *= n
    turns += (c1 * h)[:, None]
    turns *= n
    turns += (c0 - np.rint(c0))[:, None]
    turns -= np.rint(turns)
    return turns


def overlap(m: Measurements, receiver: int, path: Path) -> tuple[np.ndarray, np.ndarray]:
    """Return (first, end) sample numbers [n] between which both chirps are on at the receiver's mixer."""
    own, peer = m.stations[receiver], m.stations[1 - receiver if len(m.stations) == 2 else 0]
    g = geometry(m, receiver, path)
    last = np.minimum(g.crossing(peer.sweep.ramp_duration / peer.alpha), own.sweep.ramp_duration / own.alpha)
    begin = np.ceil(np.maximum(g.crossing(0.0), 0.0) / g.step - 1e-9)
    end = np.floor(last / g.step + 1e-9) + 1
    limit = own.sweep.sample_count
    return np.clip(begin, 0, limit).astype(int), np.clip(end, 0, limit).astype(int)


@dataclasses.dataclass(frozen=True)
class _Noise:
    """Normal deviates and oscillator spectra of a chunk."""

    additive: tuple[np.ndarray, ...]  # per station float32 [n, values]
    spectra: tuple[np.ndarray | None, ...]  # per station complex64
    periods: tuple[int, ...]


def draw_sweeps(m: Measurements, seed: int) -> list[np.random.Generator]:
    """Give each sweep its own true start delay, initial phases and amplitude; return the sweeps' generators."""
    generators = [stream(seed, Purpose.SWEEP, int(i)) for i in m.sweep_id]
    for row, generator in enumerate(generators):
        deviates = generator.standard_normal(3)
        m.start_delay[row] += m.start_delay_jitter * deviates[0]
        m.initial_phase[:, row] = generator.random(2)[: len(m.stations)]
        for station, deviate in zip(m.stations, deviates[1:], strict=False):
            station.received_power[row] += m.amplitude_scatter * deviate
    return generators


def _draw_noise(m: Measurements, generators: Sequence[np.random.Generator]) -> _Noise:
    additive_counts = [s.sweep.sample_count * (2 if s.iq else 1) for s in m.stations]
    periods, counts = [], []
    for s in m.stations:
        quiet = s.phase_noise is None
        periods.append(0 if quiet else oscillator.period(s.sweep.sample_count, s.sweep.sample_rate, s.phase_noise))
        counts.append(0 if quiet else oscillator.normal_count(periods[-1]))
    deviates = np.empty((len(m), sum(additive_counts) + sum(counts)), np.float32)
    for row, generator in zip(deviates, generators, strict=True):
        generator.standard_normal(dtype=np.float32, out=row)
    parts = np.split(deviates, np.cumsum(additive_counts + counts)[:-1], axis=1)
    spectra = []
    for s, period, normals in zip(m.stations, periods, parts[len(m.stations) :], strict=True):
        if s.phase_noise is None:
            spectra.append(None)
        else:
            spectra.append(
                oscillator.spectrum(np.ascontiguousarray(normals), period, s.sweep.sample_rate, s.phase_noise)
            )
    return _Noise(tuple(parts[: len(m.stations)]), tuple(spectra), tuple(periods))


def _phase_noise(m: Measurements, noise: _Noise, receiver: int, path: Path) -> np.ndarray | None:
    """Return phi_PN,own(u) - phi_PN,peer(v) [n, samples] [rad], None without phase noise."""
    peer_index = 1 - receiver if len(m.stations) == 2 else 0
    own, peer = m.stations[receiver], m.stations[peer_index]
    count = own.sweep.sample_count
    difference = None
    if noise.spectra[receiver] is not None:
        difference = oscillator.phase(noise.spectra[receiver], noise.periods[receiver], count, np.zeros(len(m)), None)
    if noise.spectra[peer_index] is not None:
        g = geometry(m, receiver, path)
        peer_rate = peer.sweep.sample_rate * peer.sample_clock
        drift = (1.0 - g.rate) * g.step * peer_rate - 1.0
        drift[np.abs(drift) * count < _NEGLIGIBLE_DRIFT] = 0.0
        heard = oscillator.phase(
            noise.spectra[peer_index], noise.periods[peer_index], count, -g.offset * peer_rate, drift
        )
        difference = -heard if difference is None else difference - heard
    return difference


def _receive(m: Measurements, noise: _Noise | None, receiver: int, effects: Sequence['Effect']) -> np.ndarray:
    """Return the noise-carrying analogue IF of one station [LSB], float32 [n, samples] or [n, samples, 2] (I, Q)."""
    own, peer = m.stations[receiver], m.stations[1 - receiver if len(m.stations) == 2 else 0]
    count = own.sweep.sample_count
    sample = np.arange(count)
    signal = None
    for path in m.paths:
        angle = if_turns(m, receiver, path).astype(np.float32)
        angle *= np.float32(2.0 * np.pi)
        phase_noise = None if noise is None else _phase_noise(m, noise, receiver, path)
        if phase_noise is not None:
            angle += phase_noise
        shaping = [e for e in effects if e.shapes_chirp]
        if shaping:
            g = geometry(m, receiver, path)
            u = np.arange(count) * g.step[:, None]
            v = g.peer_time(count)
            bent = np.zeros(u.shape)  # may be hundreds of turns at both stations: reduced before it is float32
            for effect in shaping:
                if effect.applies_to(own.name):
                    bent += effect.chirp_phase(own, u)
                if effect.applies_to(peer.name):
                    bent -= effect.chirp_phase(peer, v)
            bent -= 2.0 * np.pi * np.rint(bent / (2.0 * np.pi))
            angle += bent
        amplitude = (own.amplitude(own.received_power) * path.amplitude).astype(np.float32)[:, None]
        if own.iq:
            heard = np.stack([np.cos(angle), np.sin(angle)], axis=-1)
            heard *= amplitude[..., None]
        else:
            heard = np.cos(angle, out=angle)
            heard *= amplitude
        begin, end = overlap(m, receiver, path)
        head, tail = int(begin.max()), int(end.min())
        heard[:, :head][sample[:head] < begin[:, None]] = 0.0
        heard[:, tail:][sample[tail:] >= end[:, None]] = 0.0
        signal = heard if signal is None else signal + heard
    if noise is not None:
        additive = noise.additive[receiver].reshape(signal.shape)
        signal += additive * own.noise_std().astype(np.float32).reshape(-1, *[1] * (signal.ndim - 1))
    return signal


def quantise(signal: np.ndarray, full_scale: float) -> np.ndarray:
    """Return ADC codes, int16 [n, values]: rounded, clipped at -full_scale and full_scale - 1; I and Q interleaved."""
    np.rint(signal, out=signal)
    np.clip(signal, -full_scale, full_scale - 1.0, out=signal)
    return signal.astype(np.int16).reshape(len(signal), -1)


def synthesise(
    m: Measurements, seed: int, effects: Sequence['Effect'] = (), noise: bool = True, quantised: bool = True
) -> tuple[np.ndarray, ...]:
    """Return the IF samples of each station.

    Row i depends on the seed, the sweep number and that measurement's conditions only, not on the batch around it.

    Args:
        m: measurements; not changed.
        seed: of the scenario.
        effects: act in the order of their `stage`, those of one stage as listed.
        noise: False leaves out additive and phase noise.
        quantised: False returns the analogue signal in LSB, float32 [n, samples] or [n, samples, 2].

    Returns:
        Per station int16 [n, samples], or [n, 2 samples] with I and Q interleaved.
    """
    effects = sorted(effects, key=lambda effect: effect.stage)
    results = []
    for begin in range(0, len(m), _CHUNK):
        chunk = m.rows(slice(begin, begin + _CHUNK))
        generators = draw_sweeps(chunk, seed)
        for effect in effects:
            effect.prepare(chunk)
        drawn = _draw_noise(chunk, generators) if noise else None
        received = []
        for receiver, station in enumerate(chunk.stations):
            signal = _receive(chunk, drawn, receiver, effects)
            for number, effect in enumerate(effects):
                if effect.applies_to(station.name):
                    effect.receive(signal, station, chunk, _streams(seed, chunk, receiver, number))
            received.append(quantise(signal, station.full_scale) if quantised else signal)
        results.append(received)
    return tuple(np.concatenate(parts) for parts in zip(*results, strict=True))


def _streams(seed: int, m: Measurements, receiver: int, number: int):
    """Return a function that makes the generators of one effect at one station, one per sweep."""
    return lambda: [stream(seed, Purpose.EFFECT, int(i), 2 * number + receiver) for i in m.sweep_id]
