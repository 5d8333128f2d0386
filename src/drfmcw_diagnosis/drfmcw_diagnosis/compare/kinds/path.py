"""What the line's frequency and power say of the path: common beat frequency, amplitude, range, and velocity."""

import dataclasses
import itertools
import math

import numpy as np
from scipy.ndimage import median_filter

from ...features.extractor import SweepFeatures
from ...recording.grouping import noise_by_bends
from ..groups import pooled
from ..limits import MODEL, SCATTER
from ..measuring import Evidence
from ..predicting import Expected
from ..recorded_sweeps import RecordedSweeps
from .kind import Kind, Measured, Of, Plotted, Shown


@dataclasses.dataclass(frozen=True, kw_only=True)
class BeatSum(Kind):
    """Common part of both beat frequencies (G,) [Hz]: 2 k T_off and the references' difference."""

    of: Of = Of.PATH

    def measured(self, evidence: Evidence) -> Measured:
        """Return the mean over each group's calm sweeps; of one station it is not compared."""
        recorded, beats = evidence.recorded, evidence.of_calm('beat')
        std = np.full(len(beats), np.inf)
        if recorded.scatters and recorded.topology.both_heard:
            std = pooled([beat[:, None] for beat in beats])[:, 0]
        return np.array([beat.mean() for beat in beats]), np.hypot(std / evidence.calm_roots, MODEL.beat)

    def predicted(self, expected: Expected) -> np.ndarray:
        """Return that of simulated sweeps."""
        return expected.features.beat


@dataclasses.dataclass(frozen=True, kw_only=True)
class Amplitude(Kind):
    """Power of each line (G, S) [dB of 1 LSB]."""

    def measured(self, evidence: Evidence) -> Measured:
        """Return the mean over each group's calm sweeps; compared where the link budget gives it."""
        recorded, amplitudes = evidence.recorded, evidence.of_calm('amplitude')
        values = np.array([amplitude.mean(axis=0) for amplitude in amplitudes])
        std = np.full(values.shape, np.inf)
        if recorded.scatters:
            shared = SCATTER.amplitude_shared if recorded.topology.both_heard else 1.0
            std = np.where(evidence.known.power(), shared * pooled(amplitudes), np.inf)
        return values, np.hypot(std / evidence.calm_roots[:, None], MODEL.amplitude)

    def predicted(self, expected: Expected) -> np.ndarray:
        """Return that of simulated sweeps, less what phase noise takes."""
        return expected.amplitude


@dataclasses.dataclass(frozen=True, kw_only=True)
class Range(Kind):
    """Range by the combined delay beyond the reference (G,) [m]."""

    of: Of = Of.PATH

    def measured(self, evidence: Evidence) -> Measured:
        """Return the mean over each group's calm sweeps; compared where reference and calibrations give it."""
        recorded, known = evidence.recorded, evidence.known.range()
        values = np.array([e[calm].mean() for e, calm in zip(evidence.range_errors, recorded.calm, strict=True)])
        reference = [
            recorded.data.reference_std[m][calm] for m, calm in zip(recorded.members, recorded.calm, strict=True)
        ]
        pairs = zip(evidence.of_calm('range_std'), reference, strict=True)
        expected = np.array([np.mean(own**2 + np.nan_to_num(other) ** 2) for own, other in pairs])
        std = np.full(len(values), np.inf)
        if not recorded.scatters:
            std[known] = np.sqrt(expected[known])
        elif known.any():
            errors = [recorded.range_noise(int(g))[:, None] for g in np.flatnonzero(known)]
            std[known] = pooled(errors, expected[known])[:, 0]
        limit = evidence.known.range_limit()
        return values, np.hypot(np.maximum(std, SCATTER.least_range) / evidence.calm_roots, limit)

    def predicted(self, expected: Expected) -> np.ndarray:
        """Return that of simulated sweeps beyond what the reference says there."""
        return expected.features.range - expected.reference


@dataclasses.dataclass(frozen=True, kw_only=True)
class Velocity(Kind):
    """Slope of the reference (G,) [m/s]."""

    of: Of = Of.PATH

    def measured(self, evidence: Evidence) -> Measured:
        """Return the slope in each group."""
        return evidence.recorded.slope, evidence.recorded.slope_std

    def predicted(self, expected: Expected) -> np.ndarray:
        """Return the slope with which the crane drives."""
        return expected.velocity

    def over_groups(self, recorded: RecordedSweeps) -> np.ndarray:
        """Return the slope of each group [m/s], over which it is shown."""
        return recorded.slope


@dataclasses.dataclass(frozen=True, kw_only=True)
class Movement(Kind):
    """Movement of each sweep within its group (n,) [m]: by the carrier phase where that counts it, else by range."""

    of: Of = Of.PATH
    per_sweep: bool = True

    def measured(self, evidence: Evidence) -> Measured:
        """Return each sweep's movement from the group's mean; a burst turns the phase of the sweep that holds it."""
        recorded, known = evidence.recorded, evidence.known.range()
        wave = recorded.parts[0].extract.way_per_phase
        by_phase = any(part.extract.way_per_phase for part in recorded.parts)
        loud = not (recorded.whole.all() and all(s.calm.all() for s in recorded.sweeps))
        values, stds = [], []
        for g, (rows, sweeps) in enumerate(zip(recorded.members, recorded.sweeps, strict=True)):
            time = recorded.data.time[rows]
            quiet = _undisturbed(sweeps, time) if loud else np.ones(len(rows), bool)
            if recorded.counted[g]:
                turned = unwrapped(sweeps.carrier[quiet], time[quiet]) * wave
                # noise of whatever shape shows in how the phase bends from sweep to sweep, where a crane hardly does
                wander = noise_by_bends(turned) if len(turned) >= SCATTER.wander_sweeps else 0.0
                std = np.hypot(np.maximum(sweeps.phase_std * wave, wander), MODEL.movement)
                compared = by_phase
            else:
                # from sweep to sweep a drive passes more wavelengths than the reference can count
                turned = evidence.range_errors[g][quiet]
                std = np.hypot(sweeps.range_std, np.nan_to_num(recorded.data.reference_std[rows]))
                # what disturbs a line scatters from sweep to sweep, a drive does not
                if recorded.standing[g] or len(turned) >= SCATTER.wander_sweeps:
                    std = np.maximum(std, noise_by_bends(turned))
                compared = bool(known[g]) and by_phase
            moved = np.interp(np.arange(len(rows)), np.flatnonzero(quiet), turned)
            values.append(moved - moved.mean())
            stds.append(np.where(quiet & compared, std, np.inf))
        return np.concatenate(values), np.concatenate(stds)

    def common_errors(self, std: np.ndarray, expected: list[Expected]) -> list[np.ndarray]:
        """Return a movement at constant speed in each group: the air changes while the crane stands."""
        time, speed = {}, {}
        for one in expected:
            for local, group, distance in zip(one.part.local, one.part.groups, one.part.steady.range, strict=True):
                time[group] = one.part.all.time[local]
                speed[group] = MODEL.air_drift * distance
        bounds = np.cumsum([0, *(len(time[g]) for g in sorted(time))])
        found = []
        for group, (first, end) in enumerate(itertools.pairwise(bounds)):
            moved = np.zeros(len(std))
            moved[first:end] = speed[group] * (time[group] - time[group].mean())
            if np.sum((moved / std) ** 2) > MODEL.felt:
                found.append(moved)
        return found

    def predicted(self, expected: Expected) -> np.ndarray:
        """Return the movement of the model's path."""
        return expected.displacement

    def profile(self, recorded: RecordedSweeps, z: np.ndarray, positions: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Return squares over the time [s]."""
        return recorded.data.time[positions], z**2

    def plotted(self, shown: Shown) -> Plotted:
        """Return movements over the time [s]."""
        known = np.isfinite(shown.std)
        time = shown.recorded.data.time[np.concatenate(shown.recorded.members)]
        residual, std, curve = (v[known] for v in (shown.residual, shown.std, shown.curve))
        return Plotted(time[known], residual, std, curve, self.unit)


def unwrapped(phase: np.ndarray, time: np.ndarray) -> np.ndarray:
    """Return phases (n,) [rad] without jumps of whole turns, about their mean rate.

    Where sweeps are missing, the phase may turn further in the gap than can be counted; its rate before and behind the
    gap, over as many sweeps as are missing and some more, shows how far.

    Args:
        phase: at each time, up to whole turns [rad].
        time: in order (n,) [s].
    """
    if len(phase) < 2:
        return phase
    pause = np.diff(time)
    usual = float(np.median(pause))
    next_to = np.abs(pause - usual) <= SCATTER.same_pause * usual
    turn = np.exp(1j * np.diff(phase))
    mean = float(np.angle(np.sum(turn[next_to])))
    turned = mean + np.where(next_to, np.angle(turn * np.exp(-1j * mean)), 0.0)  # in the usual pause
    for gap in np.flatnonzero(~next_to & (usual > 0.0)):
        sweeps = math.ceil(pause[gap] / usual) + SCATTER.about_gap
        about = slice(max(gap - sweeps, 0), gap + sweeps + 1)
        near = turned[about][next_to[about]]
        turned[gap] = (near.mean() if len(near) else mean) * pause[gap] / usual
    trend = np.concatenate([[0.0], np.cumsum(turned)])
    return np.unwrap(phase - trend) + trend


def _undisturbed(sweeps: SweepFeatures, time: np.ndarray) -> np.ndarray:
    """Return which sweeps' phases no burst of a recording turns (n,), all where hardly any is free.

    One may also lie where the spectrum's window ends: the phase alone shows it.
    """
    quiet = sweeps.calm
    if quiet.sum() < SCATTER.wander_sweeps:
        return np.ones(len(quiet), bool)
    phase = unwrapped(sweeps.carrier[quiet], time[quiet])
    off = np.abs(phase - median_filter(phase, 3, mode='mirror'))
    if off.any():
        quiet[quiet] = off <= SCATTER.turned * np.median(off[off > 0.0])
    return quiet


BEAT = BeatSum(
    name='beat',
    level='beat_frequency',
    axis='range',
    label='common part of both beat frequencies',
    unit='Hz',
)
AMPLITUDE = Amplitude(
    name='amplitude',
    level='amplitude',
    axis='range',
    label='received power',
    unit='dB',
    needs_conditions=True,
)
RANGE = Range(
    name='range',
    level='range',
    axis='range',
    label='range beyond the reference',
    unit='m',
    averages=True,
    needs_conditions=True,
    needs_reference=True,
)
VELOCITY = Velocity(
    name='velocity',
    level='range',
    axis='velocity',
    label='slope of the reference',
    unit='m/s',
    averages=True,
    exact=True,
    needs_conditions=True,
)
MOVEMENT = Movement(name='movement', level='range', axis='time', label='movement within a group of sweeps', unit='m')
