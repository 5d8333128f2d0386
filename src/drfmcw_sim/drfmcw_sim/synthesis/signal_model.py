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
import zlib
from collections.abc import Callable, Sequence

import numpy as np

from ..effects import Effect, Stage
from ..measurements import Measurements, Path, Station
from . import oscillator
from .random_streams import Purpose, normal_pairs, stream

PHASE_UNIT = 2.0**-32
"""Unit of `if_phase` [turns]: as 32-bit integers, phases wrap by themselves."""

_CHUNK = 32  # sweeps computed together: as many as fit the processor's cache
_BLOCK = 64  # samples whose phases are computed from one start and one slope
_LOUDEST = 1e30  # amplitude beyond which no size of an effect takes a signal: sums stay within float32 [LSB]
_NEGLIGIBLE_DRIFT = 1e-3  # samples between two ADC clocks within a record, for phase noise only


@dataclasses.dataclass(frozen=True)
class Geometry:
    """Where the peer's chirp is heard: v = -offset + (1 - rate) u - acceleration u^2 / 2; arrays [n]."""

    offset: np.ndarray  # d(0) [s]
    rate: np.ndarray  # [s/s]
    acceleration: np.ndarray  # [s/s^2]
    step: np.ndarray  # true time between the receiver's samples [s]
    phase: float = 0.0  # of the IF beyond that of the delay [turns]

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
    return Geometry(offset, path.rate + path.acceleration * start, path.acceleration, step, path.phase)


def if_phase(m: Measurements, receiver: int, g: Geometry) -> np.ndarray:
    """Return the noise-free IF phase D_a of every sample, int32 [n, samples] in PHASE_UNIT, within 1e-7 rad.

    Args:
        m: measurements.
        receiver: 0 first station, 1 second.
        g: of the path over which the peer is heard.
    """
    own, peer = _own_and_peer(m, receiver)
    d, r, c, h = g.offset, g.rate, g.acceleration, g.step
    f_own, f_peer = own.alpha * own.sweep.start_frequency, peer.alpha * peer.sweep.start_frequency
    k_own, k_peer = own.alpha**2 * own.sweep.chirp_rate, peer.alpha**2 * peer.sweep.chirp_rate
    # D_a / 2 pi = f_own u + k_own u^2/2 - f_peer v - k_peer v^2/2, multiplied out; u^4 is left out, 2e-17 turns
    # with an acceleration of 10 m/s^2
    c0 = f_peer * d - 0.5 * k_peer * d * d + g.phase
    if len(m.stations) == 2:
        c0 = c0 + m.initial_phase[receiver] - m.initial_phase[1 - receiver]
    c1 = ((f_own - f_peer) + f_peer * r + k_peer * d * (1.0 - r)) * h
    c2 = (0.5 * (k_own - k_peer) + 0.5 * f_peer * c + 0.5 * k_peer * (2.0 * r - r * r - d * c)) * h * h
    c3 = 0.5 * k_peer * (1.0 - r) * c * h**3
    # sample a + b, a the middle of a block: D(a + b) = D(a) + b (D'(a) - c1) + (D(b) - c0), for the cubic term but
    # for 3 c3 a b^2, which an acceleration of 10 m/s^2 makes 1e-8 rad
    count = own.sweep.sample_count
    a = np.arange(_BLOCK // 2, count + _BLOCK // 2, _BLOCK, dtype=np.float64)
    b = np.arange(-(_BLOCK // 2), _BLOCK // 2)
    c0, c1, c2, c3 = (x[:, None] for x in (c0 - np.rint(c0), c1, c2, c3))
    start = _phase_units(((c3 * a + c2) * a + c1) * a + c0)
    slope = _phase_units((3.0 * c3 * a + 2.0 * c2) * a)
    result = slope[:, :, None] * b.astype(np.int32)
    result += start[:, :, None]
    result += _phase_units(((c3 * b + c2) * b + c1) * b)[:, None, :]
    return result.reshape(len(m), -1)[:, :count]


def _phase_units(turns: np.ndarray) -> np.ndarray:
    """Return a phase in PHASE_UNIT, int32."""
    return np.rint((turns - np.rint(turns)) * (1.0 / PHASE_UNIT)).astype(np.int64).astype(np.int32)


def _own_and_peer(m: Measurements, receiver: int) -> tuple[Station, Station]:
    """Return the receiver and the transmitter that it hears, which is itself where there is only one station."""
    return m.stations[receiver], m.stations[1 - receiver if len(m.stations) == 2 else 0]


def overlap(m: Measurements, receiver: int, g: Geometry) -> tuple[np.ndarray, np.ndarray]:
    """Return the (first, end) sample numbers [n] between which both chirps are present at the receiver's mixer."""
    own, peer = _own_and_peer(m, receiver)
    (begins, ends), (peer_begins, peer_ends) = own.on, peer.on
    last = np.minimum(g.crossing(peer_ends), ends)
    begin = np.ceil(np.maximum(g.crossing(peer_begins), begins) / g.step - 1e-9)
    end = np.floor(last / g.step + 1e-9) + 1
    limit = own.sweep.sample_count
    begin = np.clip(begin, 0, limit).astype(int)
    return begin, np.maximum(np.clip(end, 0, limit).astype(int), begin)


@dataclasses.dataclass(frozen=True)
class _Noise:
    """Noise of a chunk."""

    additive: tuple[np.ndarray, ...]  # per station float32 [n, values] [LSB]
    spectra: tuple[np.ndarray | None, ...]  # of the phase noise, per station complex64 [n, bins]
    period: int  # of the phase noise [samples]


def draw_sweeps(m: Measurements, seed: int) -> list[np.random.Generator]:
    """Give each sweep its own true start delay, initial phases and amplitude; return the sweeps' generators."""
    generators = [stream(seed, Purpose.SWEEP, int(i)) for i in m.sweep_id]
    for row, generator in enumerate(generators):
        deviates = generator.standard_normal(3)
        m.start_delay[row] += m.start_delay_jitter * deviates[0]
        m.initial_phase[:, row] += generator.random(2)[: len(m.stations)]
        for station, deviate in zip(m.stations, deviates[1:], strict=False):
            station.received_power[row] += m.amplitude_scatter * deviate
    return generators


def _draw_noise(m: Measurements, generators: Sequence[np.random.Generator]) -> _Noise:
    periods = [
        oscillator.period(s.sweep.sample_count, s.sweep.sample_rate, s.phase_noise, s.sweep.start_delay)
        for s in m.stations
        if s.phase_noise is not None
    ]
    period = max(periods, default=0)
    values = [s.sweep.sample_count * (2 if s.iq else 1) for s in m.stations]
    counts = [-(-v // 2) for v in values] + [oscillator.bin_count(period)] * len(periods)
    ends = np.cumsum(counts)[:-1]
    radii, cosines, sines = (np.split(part, ends, axis=1) for part in normal_pairs(generators, sum(counts)))
    additive = []
    for s, number, radius, cosine, sine in zip(m.stations, values, radii, cosines, sines, strict=False):
        radius *= s.noise_std().astype(np.float32)[:, None]
        half = radius.shape[1]
        deviates = np.empty((len(m), 2 * half), np.float32)
        np.multiply(radius, cosine, out=deviates[:, :half])
        np.multiply(radius, sine, out=deviates[:, half:])
        additive.append(deviates[:, :number])
    spectra: list[np.ndarray | None] = []
    of_oscillators = zip(*(parts[len(m.stations) :] for parts in (radii, cosines, sines)), strict=True)
    for s in m.stations:
        if s.phase_noise is None:
            spectra.append(None)
        else:
            radius, cosine, sine = next(of_oscillators)
            spectra.append(oscillator.spectrum(radius, cosine, sine, period, s.sweep.sample_rate, s.phase_noise))
    return _Noise(tuple(additive), tuple(spectra), period)


def _phase_noise(m: Measurements, noise: _Noise, receiver: int, g: Geometry) -> np.ndarray | None:
    """Return phi_PN,own(u) - phi_PN,peer(v) [n, samples] [rad], None without phase noise."""
    own, peer = _own_and_peer(m, receiver)
    count = own.sweep.sample_count
    difference = noise.spectra[receiver]
    emitted = noise.spectra[1 - receiver if len(m.stations) == 2 else 0]
    if emitted is None:
        return None if difference is None else oscillator.phase(difference, noise.period, count)
    peer_rate = peer.sweep.sample_rate * peer.sample_clock
    drift = (1.0 - g.rate) * g.step * peer_rate - 1.0
    drift[np.abs(drift) * count < _NEGLIGIBLE_DRIFT] = 0.0
    heard = oscillator.shifted(emitted, noise.period, drift * (count / 2) - g.offset * peer_rate)
    result = oscillator.phase(-heard if difference is None else difference - heard, noise.period, count)
    if np.any(drift):
        result -= oscillator.drift_phase(heard, noise.period, count, drift)
    return result


def _shaped(m: Measurements, receiver: int, g: Geometry, effects: Sequence[Effect]) -> np.ndarray:
    """Return what effects that shape chirps add to `if_phase` [n, samples] [rad], less whole turns."""
    own, peer = _own_and_peer(m, receiver)
    u = np.arange(own.sweep.sample_count) * g.step[:, None]
    v = g.peer_time(own.sweep.sample_count)
    bent = np.zeros(u.shape)  # may be hundreds of turns at both stations: reduced before it is float32
    for effect in effects:
        if effect.applies_to(own.name):
            bent += effect.chirp_phase(own, u)
        if effect.applies_to(peer.name):
            bent -= effect.chirp_phase(peer, v)
    for modulation in own.modulations:
        bent += modulation.chirp_phase(u)
    for modulation in peer.modulations:
        bent -= modulation.chirp_phase(v)
    bent -= 2.0 * np.pi * np.rint(bent / (2.0 * np.pi))
    return bent


def _amplitude(own: Station, path: Path, g: Geometry) -> np.ndarray:
    """Return the amplitude of what a station hears over a path, float32 [n, samples] or [n, 1] [LSB]."""
    amplitude = (own.amplitude(own.received_power) * path.amplitude)[:, None]
    if own.slope:
        per_sample = own.slope / 20.0 * own.alpha * g.step / own.sweep.ramp_duration
        amplitude = amplitude * 10.0 ** (-per_sample[:, None] * np.arange(own.sweep.sample_count))
    return np.minimum(amplitude, _LOUDEST).astype(np.float32)


def _response(own: Station) -> tuple[np.ndarray | None, np.ndarray | None]:
    """Return gain and phase [rad] of a station's measured responses over the samples, float32 [n, samples]."""
    if not own.responses:
        return None, None
    curves = [x.over_samples(own.sweep.sample_count, own.sweep.sample_rate) for x in own.responses]
    gain, turn = (np.sum(curve, axis=0) for curve in zip(*curves, strict=True))
    return np.exp(gain).astype(np.float32), turn.astype(np.float32)


def _receive(
    m: Measurements, single: Measurements, noise: _Noise | None, receiver: int, effects: Sequence[Effect]
) -> np.ndarray:
    """Return the analogue IF of one station [LSB], float32 [n, samples] or [n, samples, 2] (I, Q).

    It carries the noise, without the additive one where that enters behind the filters.
    Where `m` holds copies that differ in their initial phases alone, `single` is the first of them.
    """
    own = m.stations[receiver]
    count = own.sweep.sample_count
    sample = np.arange(count)
    shape = (len(m), count, 2) if own.iq else (len(m), count)
    shaping = [e for e in effects if e.shapes_chirp]
    gain, turn = _response(own)
    if noise is None or own.noise_behind:
        signal = np.zeros(shape, np.float32)
    else:
        signal = noise.additive[receiver].reshape(shape)
    for path, single_path in zip(m.paths, single.paths, strict=True):
        g = geometry(m, receiver, path)
        angle = if_phase(m, receiver, g).astype(np.float32)
        angle *= np.float32(2.0 * np.pi * PHASE_UNIT)
        phase_noise = None if noise is None else _phase_noise(m, noise, receiver, g)
        if phase_noise is not None:
            angle += phase_noise
        if shaping or any(s.modulations for s in m.stations):
            each = angle.reshape(-1, len(single), count)
            each += _shaped(single, receiver, geometry(single, receiver, single_path), shaping)
        if turn is not None:
            angle += turn
        amplitude = _amplitude(own, path, g)
        if gain is not None:
            amplitude = amplitude * gain
        begin, end = overlap(m, receiver, g)
        if own.iq:
            heard = np.empty(shape, np.float32)
            np.cos(angle, out=heard[..., 0])
            np.sin(angle, out=heard[..., 1])
            heard *= amplitude[..., None]
        else:
            heard = np.cos(angle, out=angle)
            heard *= amplitude
        head, tail = int(begin.max()), int(end.min())
        heard[:, :head][sample[:head] < begin[:, None]] = 0.0
        heard[:, tail:][sample[tail:] >= end[:, None]] = 0.0
        signal += heard
    return signal


def quantise(signal: np.ndarray, full_scale: float) -> np.ndarray:
    """Return ADC codes, int16 [n, values]: rounded, clipped at -full_scale and full_scale - 1; I and Q interleaved."""
    np.rint(signal, out=signal)
    np.clip(signal, -full_scale, full_scale - 1.0, out=signal)
    return signal.astype(np.int16).reshape(len(signal), -1)


def synthesise(
    m: Measurements,
    seed: int,
    effects: Sequence[Effect] = (),
    noise: bool = True,
    quantised: bool = True,
    copies: int = 1,
) -> tuple[np.ndarray, ...]:
    """Return the IF samples of each station.

    Row i depends on the seed, the sweep number and that measurement's conditions only, not on the batch around it.

    Args:
        m: measurements; not changed.
        seed: of the scenario.
        effects: act in the order of their `stage`, those of one stage as listed.
        noise: False leaves out additive and phase noise.
        quantised: False returns the analogue signal in LSB, float32 [n, samples] or [n, samples, 2].
        copies: number of copies of the same measurements in `m`, one after another, which differ in their initial
            phases alone: saves time.

    Returns:
        Per station int16 [n, samples], or [n, 2 samples] with I and Q interleaved.
    """
    effects = sorted(effects, key=lambda effect: effect.stage)
    numbers = _stream_numbers(effects)
    results: list[np.ndarray] = []
    numbered = np.arange(len(m)).reshape(copies, -1)
    each = max(_CHUNK // copies, 1)
    for begin in range(0, numbered.shape[1], each):
        rows = numbered[:, begin : begin + each].ravel()
        chunk = m.rows(rows)
        generators = draw_sweeps(chunk, seed)
        for effect in effects:
            effect.prepare(chunk)
        for effect, number in zip(effects, numbers, strict=True):
            for receiver, station in enumerate(chunk.stations):
                if effect.applies_to(station.name):
                    effect.draw(station, _streams(seed, chunk, receiver, number))
        single = chunk.rows(slice(0, len(chunk) // copies)) if copies > 1 else chunk
        drawn = _draw_noise(chunk, generators) if noise else None
        for receiver, station in enumerate(chunk.stations):
            signal = _receive(chunk, single, drawn, receiver, effects)
            pending = drawn.additive[receiver] if drawn and station.noise_behind else None
            for effect, number in zip(effects, numbers, strict=True):
                if pending is not None and effect.stage > Stage.FILTER:
                    signal += pending.reshape(signal.shape)
                    pending = None
                if effect.applies_to(station.name):
                    effect.receive(signal, station, chunk, _streams(seed, chunk, receiver, number))
            if pending is not None:
                signal += pending.reshape(signal.shape)
            samples = quantise(signal, station.full_scale) if quantised else signal
            if begin == 0:
                results.append(np.empty((len(m), *samples.shape[1:]), samples.dtype))
            results[receiver][rows] = samples
    return tuple(results)


def _stream_numbers(effects: Sequence[Effect]) -> list[int]:
    """Return a number for the random streams of each effect, from its name and the count of that name before it.

    So an effect keeps its random numbers whatever other effects act.
    """
    names = [effect.name for effect in effects]
    return [(zlib.crc32(name.encode()) << 8) + names[:i].count(name) for i, name in enumerate(names)]


def _streams(seed: int, m: Measurements, receiver: int, number: int) -> Callable[[], list[np.random.Generator]]:
    """Return a function that returns the generators of one effect at one station, one per sweep."""
    return lambda: [stream(seed, Purpose.EFFECT, int(i), 2 * number + receiver) for i in m.sweep_id]
