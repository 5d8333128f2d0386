"""Samples of both stations from the exact phases of their chirps, written from the text of the interfaces alone.

A station counts sigma = alpha u, u the true time since its own sweep start, and transmits f(sigma) = f_0 + k sigma
times its reference. A mixer that hears at u what the peer sent at v = u - d sees

    D / 2 pi = w (f_0 + k (sigma_own + sigma_peer) / 2),   w = sigma_own - sigma_peer
             = (alpha_own - alpha_peer) u + alpha_peer d

which is the difference of two squares factorised: w is microseconds and is never formed as a difference of times, so
that float64 keeps 1e-10 rad of phases that themselves reach 1e7 rad.
"""

import dataclasses
import enum
import math
from collections.abc import Callable
from typing import Any

import numpy as np
from scipy import fft

from .condition import Condition
from .phase_noise import NoiseShape, phase_noise_density

SPEED_OF_LIGHT = 299792458.0
FIRST, SECOND = 0, 1
CHUNK = 32  # sweeps worked on at once; the noise of a chunk depends on its number alone
_EDGE = 96  # samples at either end of a record between which a chirp may begin or end
_MARGIN = 64  # samples before and after the record over which a filter settles, where there is one
_PERIOD_MARGIN = 96 + 2 * _MARGIN  # samples of phase noise beyond the record: longest delay

Rows = np.ndarray
Samples = np.ndarray


class Stream(enum.IntEnum):
    """What random numbers are drawn for; each has its own, so that an effect changes nobody else's."""

    NUISANCE = 0
    REFERENCE = 1
    THERMAL = 2
    OSCILLATOR = 3
    OUTLIER = 4
    EFFECT = 5


class Stage(enum.IntEnum):
    """Order in which effects meet the IF signal; what is added at the input passes the IF filter."""

    INPUT = 0
    COUPLING = 1
    AMPLIFIER = 2
    LIMITER = 3


def refractivity(temperature: np.ndarray, pressure: np.ndarray, humidity: np.ndarray) -> np.ndarray:
    """Return N [1e-6] by ITU-R P.453: from [degC], [Pa], [0..1]; saturation over water, with enhancement factor."""
    hpa, kelvin = pressure / 100.0, temperature + 273.15
    enhancement = 1.0 + 1e-4 * (7.2 + hpa * (0.0320 + 5.9e-6 * temperature**2))
    saturated = enhancement * 6.1121 * np.exp((18.678 - temperature / 234.5) * temperature / (temperature + 257.14))
    vapour = humidity * saturated
    return 77.6 * (hpa - vapour) / kelvin + 72.0 * vapour / kelvin + 3.75e5 * vapour / kelvin**2


@dataclasses.dataclass(frozen=True)
class Ray:
    """One way of the signal: its length from the direct one, and its amplitude."""

    length: Callable[[np.ndarray], np.ndarray]
    amplitude: float | np.ndarray = 1.0  # [n] where it differs from sweep to sweep
    phase: float | np.ndarray = 0.0  # of the reflection, by which the received wave lags, as over a longer way [rad]


@dataclasses.dataclass(frozen=True)
class Motion:
    """Displacement of the crane from its setting's distance: f(rows, time) [m], time [rows, ...] since the start."""

    displacement: Callable[[Rows, np.ndarray], np.ndarray]
    seen: bool  # by the reference instrument


AnalogueHook = Callable[['Scene', int, Rows, Samples], Samples]
ChirpHook = Callable[[np.ndarray], np.ndarray]


@dataclasses.dataclass
class Scene:
    """Everything that is true of n sweeps; effects change it. Arrays [n], or [2, n] over stations."""

    condition: Condition
    setting: np.ndarray
    time: np.ndarray  # of station 1's sweep start since the recording's [s]
    distance: np.ndarray  # of the setting [m]
    board: np.ndarray  # [2, n] [degC]
    refractivity: np.ndarray  # [1e-6]
    delay: np.ndarray  # of both stations' hardware [s]
    alpha: np.ndarray  # [2, n]
    clock: np.ndarray  # [2, n] ADC clock / nominal
    nominal_start_delay: np.ndarray
    start_delay: np.ndarray
    phase: np.ndarray  # [2, n] initial phases [turns]
    gain: np.ndarray  # [2, n] about the link budget [dB]
    noise_floor: np.ndarray  # [2, n] [dBm/Hz]
    oscillators: list[tuple[float, float, NoiseShape]]  # level, corner, shape of each station
    motions: list[Motion] = dataclasses.field(default_factory=list)
    rays: list[Ray] = dataclasses.field(default_factory=lambda: [Ray(lambda r: r)])
    antenna_distance: Callable[[np.ndarray], np.ndarray] | None = None  # from the reference's distance
    chirp: tuple[list[ChirpHook], list[ChirpHook]] = dataclasses.field(default_factory=lambda: ([], []))
    hums: tuple[list[Any], list[Any]] = dataclasses.field(default_factory=lambda: ([], []))  # (Hz, Hz, stream)
    warp: tuple[list[Any], list[Any]] = dataclasses.field(default_factory=lambda: ([], []))
    analogue: tuple[list[tuple[Stage, AnalogueHook]], list[tuple[Stage, AnalogueHook]]] = dataclasses.field(
        default_factory=lambda: ([], [])
    )
    digital: tuple[list[AnalogueHook], list[AnalogueHook]] = dataclasses.field(default_factory=lambda: ([], []))
    responses: tuple[list[Any], list[Any]] = dataclasses.field(default_factory=lambda: ([], []))  # f(|Hz|), complex
    poles: tuple[list[float], list[float]] = dataclasses.field(default_factory=lambda: ([], []))
    straight: list[tuple[float, float]] = dataclasses.field(default_factory=lambda: [(0.0, math.inf)] * 2)  # ramp [s]
    noise_behind: list[bool] = dataclasses.field(default_factory=lambda: [False, False])  # the filters
    reference_lag: float = 0.0
    reference_errors: list[Callable[[np.ndarray], np.ndarray]] = dataclasses.field(default_factory=list)
    burst_power: list[tuple[int, float, float, float]] = dataclasses.field(default_factory=list)
    own_phases: list[tuple[int, int, int]] = dataclasses.field(default_factory=list)  # stream, number, station
    fall: list[float] = dataclasses.field(default_factory=lambda: [0.0, 0.0])  # of rays over the own ramp [dB]
    advance: float = 0.0  # of these phases from those drawn, as in another realisation [turns]

    def __len__(self) -> int:
        """Return the number of sweeps."""
        return len(self.time)

    def stream(self, purpose: Stream, *key: int) -> np.random.Generator:
        """Return the generator of a purpose and key."""
        return np.random.Generator(np.random.SFC64(np.random.SeedSequence([self.condition.seed, purpose, *key])))

    def own_phase(self, stream: int, number: int, station: int, rows: Rows) -> np.ndarray:
        """Return the phase that an effect draws in every sweep [rows] [turns]; it is one of `own_phases`.

        Effects advance by different odd multiples of `advance`: over a circle of advances they keep no time.
        """
        drawn = np.array([self.stream(Stream.EFFECT, stream, number, station, int(row)).random() for row in rows])
        return drawn + (2 * self.own_phases.index((stream, number, station)) + 1) * self.advance

    def range_at(self, rows: Rows, time: np.ndarray, seen_only: bool = False) -> np.ndarray:
        """Return the distance of antennas, or what a reference instrument aims at, at `time` [rows, ...] [m]."""
        result = self.distance[rows].reshape((-1,) + (1,) * (time.ndim - 1))
        for motion in self.motions:
            if motion.seen or not seen_only:
                result = result + motion.displacement(rows, time)
        if self.antenna_distance is not None and not seen_only:
            result = self.antenna_distance(result)
        return result

    def reference(self) -> np.ndarray:
        """Return the readings of the reference instrument at each sweep's start, its noise included [n] [m]."""
        rows = np.arange(len(self))
        reading = self.range_at(rows, self.time - self.reference_lag, seen_only=True)
        error = sum((e(reading) for e in self.reference_errors), np.zeros(len(self)))
        return reading + error + self.condition.reference_std * self.stream(Stream.REFERENCE).standard_normal(len(self))

    def step(self, station: int) -> np.ndarray:
        """Return the true time between samples [n] [s]."""
        return 1.0 / (self.condition.sample_rate * self.clock[station])

    def amplitude(self, station: int, rows: Rows) -> np.ndarray:
        """Return the amplitude of the direct ray by Friis' equation [rows] [LSB]."""
        c = self.condition
        far = np.maximum(self.range_at(rows, self.time[rows]), 0.1)
        wavelength = SPEED_OF_LIGHT / (c.start_frequency + 0.5 * c.bandwidth)
        power = c.tx_eirp + c.rx_antenna_gain + 20.0 * np.log10(wavelength / (4.0 * math.pi * far))
        return c.full_scale * 10.0 ** ((power + self.gain[station, rows] - c.full_scale_power) / 20.0)

    def noise_std(self, station: int) -> np.ndarray:
        """Return the standard deviation of the additive noise [n] [LSB]; a full-scale sine has the power FS^2/2."""
        c = self.condition
        power = self.noise_floor[station] + 10.0 * math.log10(0.5 * c.sample_rate) - c.full_scale_power
        return c.full_scale * math.sqrt(0.5) * 10.0 ** (power / 20.0)


def nominal(condition: Condition) -> Scene:
    """Return the scene of a condition without any effect: nuisances of each sweep, weather, calibration."""
    c = condition
    settings = len(c.distances)
    n = settings * c.sweeps
    setting = np.repeat(np.arange(settings), c.sweeps)
    within = np.tile(np.arange(c.sweeps), settings)
    time = setting * (c.pause + c.sweeps * c.interval) + within * c.interval
    air = np.array([c.air_temperature, c.air_pressure, c.air_humidity])[:, setting]
    distance = np.array(c.distances)[setting]
    start_delay = np.where(distance < c.mode_boundary, c.short_start_delay, c.long_start_delay)
    random = np.random.Generator(np.random.SFC64(np.random.SeedSequence([c.seed, Stream.NUISANCE])))
    jitter, scatter = random.standard_normal((2, n))
    phase = random.random((2, n))
    gain = c.amplitude_scatter * scatter + c.amplitude_drift * _wander(random, n)
    scene = Scene(
        condition=c,
        setting=setting,
        time=time,
        distance=distance,
        board=np.array(c.board_temperature)[:, setting],
        refractivity=refractivity(*air),
        delay=np.full(n, c.stations[0].delay + c.stations[1].delay),
        alpha=np.array([np.full(n, s.alpha) for s in c.stations]),
        clock=np.array([np.full(n, s.sample_clock_alpha) for s in c.stations]),
        nominal_start_delay=start_delay,
        start_delay=start_delay + c.start_delay_jitter * jitter,
        phase=phase,
        gain=np.array([gain, gain]),
        noise_floor=np.array([np.full(n, s.noise_floor) for s in c.stations]),
        oscillators=[(s.phase_noise_level, s.phase_noise_corner, s.shape) for s in c.stations],
    )
    if c.outlier_probability > 0.0:
        outliers = scene.stream(Stream.OUTLIER)
        bad = outliers.random(n) < c.outlier_probability
        scene.start_delay = scene.start_delay + bad * outliers.normal(0.0, 15e-9, n)
        scene.gain = scene.gain - bad * outliers.uniform(3.0, 12.0, n)
        scene.noise_floor = scene.noise_floor + bad * outliers.uniform(3.0, 10.0, (2, n))
    return scene


def _wander(random: np.random.Generator, n: int) -> np.ndarray:
    """Return a slow curve of zero mean and unit standard deviation [n]: four cosines of falling weight."""
    x = (np.arange(n) + 0.5) / n
    order = np.arange(1, 5)
    curve = (random.standard_normal(4) / order) @ np.cos(math.pi * order[:, None] * x)
    return (curve - np.mean(curve)) / np.std(curve)


@dataclasses.dataclass(frozen=True)
class Heard:
    """What one station hears over one ray, over the record and `margin` samples before and after it."""

    amplitude: np.ndarray  # [rows, 1], or [rows, margin + samples + margin] where it falls over the ramp [LSB]
    turns: np.ndarray  # [rows, margin + samples + margin] phase of the IF, float64, not wrapped
    u: np.ndarray  # [rows, samples] since the own sweep start [s]
    off: tuple[np.ndarray, np.ndarray]  # [rows, edge] at either end of the record: True where one chirp is off
    on: tuple[np.ndarray, np.ndarray]  # [rows, 1] times u from and to which both chirps are on, none at all where empty
    lag: np.ndarray  # [rows] age of the peer's chirp at mid-record [s]

    def silence(self, signal: np.ndarray) -> None:
        """Set the samples of the record to zero during which not both chirps are on."""
        signal[:, : self.off[0].shape[1]][self.off[0]] = 0.0
        signal[:, -self.off[1].shape[1] :][self.off[1]] = 0.0


def hummed(scene: Scene, station: int, rows: Rows, time: np.ndarray) -> np.ndarray | float:
    """Return what sines of random phase add to what a station sends at `time` [rows, samples] [s], in turns."""
    total: np.ndarray | float = 0.0
    for deviation, rate, (stream, number) in scene.hums[station]:
        start = scene.own_phase(stream, number, station, rows)[:, None]
        cosines = np.cos(2.0 * math.pi * start) - np.cos(2.0 * math.pi * (rate * time + start))
        total = total + deviation / (2.0 * math.pi * rate) * cosines
    return total


def _longest_window(scene: Scene) -> int:
    """Return the samples that a window leaves out at either end of a ramp, at most."""
    c = scene.condition
    out = max(max(start, c.ramp_duration - end, 0.0) for start, end in scene.straight)
    return math.ceil(1.001 * out * c.sample_rate)


def heard(scene: Scene, station: int, rows: Rows, ray: Ray, margin: int = 0) -> Heard:
    """Return the noise-free IF of `station` over one ray."""
    c, peer = scene.condition, 1 - station
    u = scene.step(station)[rows, None] * np.arange(-margin, c.sample_count + margin)
    for warp in scene.warp[station]:
        u = warp(scene, rows, u)
    offset = scene.start_delay[rows, None]
    own_start = 0.0 if station == FIRST else offset
    if scene.motions:
        far = scene.range_at(rows, scene.time[rows, None] + own_start + u)
    else:
        far = scene.range_at(rows, scene.time[rows, None])
    slowness = (1.0 + 1e-6 * scene.refractivity[rows, None]) / SPEED_OF_LIGHT
    flight = scene.delay[rows, None] + slowness * ray.length(far)
    d = flight + offset if station == FIRST else flight - offset
    a, b = scene.alpha[station, rows, None], scene.alpha[peer, rows, None]
    w = (a - b) * u
    w += b * d
    turns = (0.5 * c.chirp_rate) * (a + b) * u
    turns += c.start_frequency - (0.5 * c.chirp_rate) * b * d
    turns *= w
    turned = np.broadcast_to(ray.phase, (len(scene),))[rows] / (2.0 * math.pi)
    turns += (scene.phase[station, rows] - scene.phase[peer, rows] + turned)[:, None]
    if scene.chirp[station] or scene.chirp[peer]:
        v = u - d
        for shape in scene.chirp[station]:
            turns += shape(a * u)
        for shape in scene.chirp[peer]:
            turns -= shape(b * v)
    if scene.hums[station] or scene.hums[peer]:
        turns += hummed(scene, station, rows, u)
        turns -= hummed(scene, peer, rows, u - d)
    of_ray = np.broadcast_to(ray.amplitude, (len(scene),))[rows]
    amplitude = (scene.amplitude(station, rows) * of_ray)[:, None]
    if scene.fall[station]:
        amplitude = amplitude * np.exp(-math.log(10.0) / 20.0 * scene.fall[station] * (a * u / c.ramp_duration))
    u = u[:, margin : margin + c.sample_count]
    first, last = d[:, :1], d[:, -1:]  # a crane moves nanometres while a chirp begins
    (start, end), (peer_start, peer_end) = (scene.straight[s] for s in (station, peer))
    on = (
        np.maximum(peer_start / b + first, start / a),
        np.minimum(min(end, c.ramp_duration) / a, min(peer_end, c.ramp_duration) / b + last),
    )
    edge = min(_EDGE + _longest_window(scene), u.shape[1])
    off = tuple((u[:, part] < on[0]) | (u[:, part] > on[1]) for part in (slice(None, edge), slice(-edge, None)))
    return Heard(amplitude, turns, u, (off[0], off[1]), on, d[:, d.shape[1] // 2])


def clean(scene: Scene, station: int, rows: Rows) -> np.ndarray:
    """Return the noise-free IF before the receiver's own faults, with its quadrature: complex [rows, samples] [LSB]."""
    margin = _MARGIN if scene.responses[station] else 0
    total = np.zeros((len(rows), scene.condition.sample_count), complex)
    for ray in scene.rays:
        one = heard(scene, station, rows, ray, margin)
        part = one.amplitude * np.exp(2j * math.pi * (one.turns - np.rint(one.turns)))
        total += _through(scene, station, rows, one, part)
    return total


def _through(scene: Scene, station: int, rows: Rows, one: Heard, signal: np.ndarray) -> np.ndarray:
    """Return a ray's signal behind the IF filter, silent where a chirp is off: [rows, samples].

    With a filter `signal` is complex and goes on beyond the record, so that the filter meets no step: a real one meets
    the step before it is sampled, and answers with an exponential of its pole, which is added.
    """
    if not scene.responses[station]:
        one.silence(signal)
        return signal
    count = scene.condition.sample_count
    taper = np.ones(signal.shape[1], np.float32)
    taper[:_MARGIN] = np.sin(0.5 * math.pi * (np.arange(_MARGIN) + 0.5) / _MARGIN) ** 2
    taper[-_MARGIN:] = taper[:_MARGIN][::-1]
    signal = signal * taper
    frequency = np.fft.fftfreq(signal.shape[1]) / scene.step(station)[rows, None]
    for response in scene.responses[station]:
        one_sided = response(np.abs(frequency))
        two_sided = np.where(frequency >= 0.0, one_sided, np.conj(one_sided)).astype(signal.dtype)
        signal = fft.ifft(fft.fft(signal) * two_sided)
    signal = signal[:, _MARGIN : _MARGIN + count]
    settled = signal.copy()
    one.silence(settled)
    for pole in scene.poles[station]:
        for edge, sign in zip(one.on, (-1.0, 1.0), strict=True):
            since = one.u - edge
            inside = (edge > 0.0) & (since >= 0.0)
            index = np.clip(np.sum(since < 0.0, axis=1), 1, count - 1)[:, None]
            last, here = (np.take_along_axis(signal, index - i, axis=1) for i in (1, 0))
            share = np.take_along_axis(since, index, axis=1) / scene.step(station)[rows, None]
            at_edge = here * np.exp(-1j * np.angle(here * np.conj(last)) * share)
            fading = np.exp((-2.0 * math.pi * pole) * np.where(inside, since, np.inf))
            settled += (sign * at_edge).astype(signal.dtype) * fading.astype(signal.real.dtype)
    return settled


class _Oscillators:
    """Phase noise of both stations in some sweeps, on a circle a little longer than the record.

    White noise in time is shaped in frequency, which takes any spectrum and any fraction of a sample of delay.
    """

    def __init__(self, scene: Scene, rows: Rows, random: np.random.Generator) -> None:
        c = scene.condition
        self.scene, self.rows, self.count = scene, rows, c.sample_count
        self.fold = 2 if any(shape.kind == 'aliased' for *_, shape in scene.oscillators) else 1
        self.period = fft.next_fast_len(c.sample_count + _PERIOD_MARGIN, real=True) * self.fold
        self.rate = c.sample_rate * self.fold
        frequency = np.arange(self.period // 2 + 1) * (self.rate / self.period)
        self.angle = (-2.0 * math.pi * frequency).astype(np.float32)  # per second of delay
        self.spectra = []
        for level, corner, shape in scene.oscillators:
            white = random.standard_normal((len(rows), self.period), dtype=np.float32)
            density = phase_noise_density(frequency, level, corner, shape)
            # white noise of unit variance has the two-sided density 1 / rate, phase noise has L
            self.spectra.append(fft.rfft(white) * np.sqrt(density * self.rate).astype(np.float32))

    def _back(self, spectrum: np.ndarray, margin: int) -> np.ndarray:
        circle = fft.irfft(spectrum, self.period)[:, :: self.fold]
        if margin:
            circle = np.roll(circle, margin, axis=1)
        return circle[:, : self.count + 2 * margin]

    def difference(self, station: int, lag: np.ndarray, margin: int = 0) -> np.ndarray:
        """Return the own phase noise minus the peer's of `lag` [rows] [s] before, float32 [rows, samples] [rad]."""
        peer = 1 - station
        turn = lag[:, None].astype(np.float32) * self.angle
        late = self.spectra[peer] * (np.cos(turn) + 1j * np.sin(turn))
        result = self._back(self.spectra[station] - late, margin)
        # the peer's clock runs differently: to first order, with the derivative of what it sent
        drift = self.scene.clock[peer, self.rows] / self.scene.clock[station, self.rows] - 1.0
        if np.any(np.abs(drift) > 1e-6):
            slope = self._back(late * (-1j * self.angle), margin)
            middle = (np.arange(-margin, self.count + margin) - self.count / 2) / self.scene.condition.sample_rate
            result -= (drift[:, None] * middle).astype(np.float32) * slope
        return result


def receive(scene: Scene, station: int, rows: Rows, rays: np.ndarray, noise: np.ndarray) -> np.ndarray:
    """Return what stands before the ADC, from filtered rays and white noise; [rows, samples] [LSB]."""
    hooks = sorted(scene.analogue[station], key=lambda pair: pair[0])
    signal = np.zeros_like(noise) if scene.noise_behind[station] else noise
    for stage, hook in hooks:
        if stage is Stage.INPUT:
            signal = hook(scene, station, rows, signal)
    for response in scene.responses[station]:
        frequency = np.fft.rfftfreq(signal.shape[1]) / scene.step(station)[rows, None]
        signal = fft.irfft(fft.rfft(signal) * response(frequency), signal.shape[1])
    signal = signal + rays
    for stage, hook in hooks:
        if stage is Stage.COUPLING:
            signal = hook(scene, station, rows, signal)
    if scene.noise_behind[station]:
        signal = signal + noise
    for stage, hook in hooks:
        if stage > Stage.COUPLING:
            signal = hook(scene, station, rows, signal)
    return signal


def digitise(scene: Scene, station: int, rows: Rows, signal: np.ndarray) -> np.ndarray:
    """Return the ADC's codes, int16 [rows, samples]."""
    top = scene.condition.full_scale
    codes = np.clip(np.rint(signal), -top, top - 1).astype(np.int16)
    for hook in scene.digital[station]:
        codes = hook(scene, station, rows, codes)
    return codes


def chunks(scene: Scene) -> list[Rows]:
    """Return the rows of the scene in the chunks in which they are rendered."""
    return [np.arange(i, min(i + CHUNK, len(scene))) for i in range(0, len(scene), CHUNK)]


def render_chunk(scene: Scene, rows: Rows) -> tuple[np.ndarray, np.ndarray]:
    """Return the codes of both stations, int16 [rows, samples]; `rows` as `chunks` gives them."""
    number = int(rows[0]) // CHUNK
    oscillators = _Oscillators(scene, rows, scene.stream(Stream.OSCILLATOR, number))
    result = []
    for station in (FIRST, SECOND):
        margin = _MARGIN if scene.responses[station] else 0
        signal = np.zeros((len(rows), scene.condition.sample_count), np.float32)
        for ray in scene.rays:
            one = heard(scene, station, rows, ray, margin)
            turns = one.turns
            turns -= np.rint(turns)
            angle = turns.astype(np.float32)
            angle *= np.float32(2.0 * math.pi)
            angle += oscillators.difference(station, one.lag, margin)
            if margin:
                part = one.amplitude.astype(np.float32) * np.exp(1j * angle)
                signal += _through(scene, station, rows, one, part).real
                continue
            part = np.cos(angle, out=angle)
            part *= one.amplitude.astype(np.float32)
            one.silence(part)
            signal += part
        noise = scene.stream(Stream.THERMAL, number, station).standard_normal(signal.shape, dtype=np.float32)
        noise *= scene.noise_std(station)[rows, None].astype(np.float32)
        result.append(digitise(scene, station, rows, receive(scene, station, rows, signal, noise)))
    return result[0], result[1]


def render(scene: Scene) -> tuple[np.ndarray, np.ndarray]:
    """Return the codes of both stations, int16 [n, samples] each."""
    parts = [render_chunk(scene, rows) for rows in chunks(scene)]
    return np.concatenate([p[0] for p in parts]), np.concatenate([p[1] for p in parts])
