"""From the beat frequencies of one sweep to a path delay and its standard deviation (eqs. 1-6, 15-19)."""

import dataclasses
import functools
import math

from drfmcw_node.processing.records import Beat
from drfmcw_physics import bounds
from drfmcw_physics.oscillators import Alpha, Calibration, delay_from_beat_sum
from drfmcw_physics.phase_noise import PhaseNoise
from drfmcw_physics.sweep import SweepSettings, beat_frequency

_DELAY_GRID = 1e-9  # phase noise through the combination is smooth in the delay: one value per nanosecond [s]


@dataclasses.dataclass(frozen=True)
class Station:
    """One station's share in a measurement: its result, settings and calibration."""

    beat: Beat
    sweep: SweepSettings
    calibration: Calibration


@dataclasses.dataclass(frozen=True)
class PathDelay:
    """Delay of the whole path in one sweep, hardware included, as a standing crane would have it."""

    uncorrected: float  # every clock taken as nominal [s]
    delay: float  # clocks corrected [s]
    std: float  # one standard deviation [s]
    carrier_phase: float  # sum of both stations' phases, NaN where not defined [rad]
    center_time: float  # centre of the analysis window after station 1's sweep start [s]
    center_frequency: float  # sweep frequency at that time [Hz]
    phase_frequency: float  # half a turn of carrier_phase per delay, NaN where that is [Hz]
    start_delay_excess: float = math.nan  # see `start_delay_excess` [s]


def combine(first: Station, second: Station, alpha_correction: bool = True) -> PathDelay:
    """Combine both stations' results of one sweep.

    The start times and offsets cancel as in eqs. 5 and 6. Since each station analyses the part of the sweep in which
    both chirps are on, its window is shifted by T_off against its own sweep start, so that both windows cover the same
    absolute time and T_off cancels with different reference clocks as well (eqs. 16-18); the little by which
    differing sample clocks still separate the windows is corrected exactly.

    Args:
        first: station 1 (starts first).
        second: station 2.
        alpha_correction: use the calibrated clocks; False takes all as nominal.
    """
    sweep = first.sweep
    k = sweep.chirp_rate
    sign = second.sweep.line_sign() * sweep.line_sign()
    raw_sum = sweep.line_sign() * (first.beat.frequency - sign * second.beat.frequency)
    uncorrected = delay_from_beat_sum(raw_sum, k, 1.0, 1.0)
    center = sweep.window_center()
    delay = uncorrected
    if alpha_correction:
        sweeps, calibrations = (first.sweep, second.sweep), (first.calibration, second.calibration)
        delay = delay_on_true_clocks(sweeps, calibrations, (first.beat.frequency, second.beat.frequency))
        center = center / first.calibration.sample_clock_alpha
    excess = start_delay_excess(first, second, delay)
    alphas = (first.calibration.alpha, second.calibration.alpha) if alpha_correction else (1.0, 1.0)
    return PathDelay(
        uncorrected=uncorrected,
        delay=delay,
        std=_delay_std(first, second, delay),
        carrier_phase=_carrier_phase(first, second, delay, excess),
        center_time=center,
        center_frequency=sweep.start_frequency + k * center,
        phase_frequency=_phase_frequency(sweep, delay) * sum(alphas) / 2.0,
        start_delay_excess=excess,
    )


def delay_on_true_clocks(
    sweeps: tuple[SweepSettings, SweepSettings],
    calibrations: tuple[Calibration, Calibration],
    frequency: tuple[Alpha, Alpha],
) -> Alpha:
    """Return the delay of the whole path by both beat frequencies [Hz], clocks corrected as in `combine` [s]."""
    first, second = sweeps
    a1, a2 = (c.alpha for c in calibrations)
    b1, b2 = (c.sample_clock_alpha for c in calibrations)
    true_sum = first.line_sign() * (b1 * frequency[0] - second.line_sign() * first.line_sign() * b2 * frequency[1])
    gap = first.window_center() / b1 - second.window_center() / b2 - first.start_delay
    true_sum -= (a1**2 - a2**2) * first.chirp_rate * gap
    return delay_from_beat_sum(true_sum, first.chirp_rate, a1, a2)


def own_path(station: Station, alpha_correction: bool = True) -> PathDelay:
    """Return the delay of a station that hears itself: its line stands at k tau (reflector or cable loop).

    Args and result as `combine`.
    """
    sweep, calibration = station.sweep, station.calibration
    k = abs(sweep.chirp_rate)
    uncorrected = station.beat.frequency / k
    delay = uncorrected
    if alpha_correction:
        delay *= calibration.sample_clock_alpha / calibration.alpha**2
    center = sweep.window_center()
    return PathDelay(
        uncorrected=uncorrected,
        delay=delay,
        std=station.beat.frequency_std / k,
        carrier_phase=math.nan,
        center_time=center,
        center_frequency=sweep.start_frequency + sweep.chirp_rate * center,
        phase_frequency=math.nan,
    )


def _carrier_phase(first: Station, second: Station, delay: float, excess: float) -> float:
    """Return phi_IF,1 - phi_IF,2 at the same absolute time, in which the oscillators' phases and T_off cancel [rad].

    Both phases are reported at the centre of the station's own sweep; station 2's lies T_off later. The true T_off
    differs from the nominal one by nanoseconds from sweep to sweep, which would be 0.03 mm of range; the frequencies
    determine it to some picoseconds.
    """
    s1, s2 = first.sweep.line_sign(), second.sweep.line_sign()
    k, start_delay = first.sweep.chirp_rate, first.sweep.start_delay
    late = 2.0 * math.pi * second.beat.frequency * (start_delay + excess)
    # [phi_1(t) - phi_1(t - tau)] + [phi_2(t - T_off) - phi_2(t - T_off - tau)]: the second interval's chirp is earlier
    return s1 * first.beat.phase - s2 * (second.beat.phase - late) + 2.0 * math.pi * k * excess * delay


def _phase_frequency(sweep: SweepSettings, delay: float) -> float:
    """Return the mean frequency at which both chirps pass the path when `_carrier_phase` looks at them [Hz].

    Each has left its station by the delay before, and station 2's began T_off later: up to 1e-4 below the centre.
    """
    k = sweep.chirp_rate
    return sweep.start_frequency + k * (sweep.ramp_duration / 2.0 - sweep.start_delay / 2.0 - delay)


def start_delay_excess(first: Station, second: Station, delay: float) -> float:
    """Return by how much the true T_off exceeds the nominal one in this sweep [s]; 2 k T_off is in f_1 +- f_2."""
    sign = first.sweep.line_sign() * second.sweep.line_sign()
    a1, a2 = first.calibration.alpha, second.calibration.alpha
    measured = first.calibration.sample_clock_alpha * first.beat.frequency
    measured += sign * second.calibration.sample_clock_alpha * second.beat.frequency
    expected = beat_frequency(first.sweep, delay, a1, a2) + sign * beat_frequency(second.sweep, delay, a2, a1)
    return (measured - expected) / (2.0 * abs(first.sweep.chirp_rate) * a2**2)


def _delay_std(first: Station, second: Station, delay: float) -> float:
    """Return the standard deviation of the combined delay [s].

    Additive noise and the mirror line's share are independent at the two stations; each oscillator's phase noise
    reaches both and passes the combination through 4 sin^2(pi f tau), where both weigh their samples alike.
    """
    beats = first.beat, second.beat
    oscillators = [
        PhaseNoise(s.calibration.phase_noise_level, s.calibration.phase_noise_corner) for s in (first, second)
    ]
    window = first.beat.window
    if not math.isfinite(delay):  # a sweep without a line
        return math.inf
    shared = window and window == second.beat.window and all(oscillator.known for oscillator in oscillators)
    if not shared or not all(beat.independent_std > 0.0 for beat in beats):
        variance = sum(beat.frequency_std**2 for beat in beats)
    else:
        start, end = first.sweep.analysis_window()
        rounded = round(abs(delay) / _DELAY_GRID) * _DELAY_GRID
        variance = sum(beat.independent_std**2 for beat in beats)
        variance += sum(_phase_noise_std(o, end - start, window, rounded) ** 2 for o in oscillators)
    return math.sqrt(variance) / abs(2.0 * first.sweep.chirp_rate)


@functools.lru_cache(maxsize=65536)
def _phase_noise_std(noise: PhaseNoise, duration: float, window: str, delay: float) -> float:
    return bounds.phase_noise_std(noise, duration, window, delay)
