"""Errors against the reference, per distance setting."""

import dataclasses
import math

import numpy as np

from drfmcw_physics.sweep import Mode

from ..offline import Reference
from ..pipeline import Flag, RangeResult

_INTERPOLATION_LIMIT = 5.0  # between a sweep and each of the two reference readings around it [s]
_NEAREST_LIMIT = 0.1  # between a sweep and a reading on one side only [s]
_PAUSE = 2.0  # a longer one between sweeps begins a new setting [s]
_FASTEST = 10.0  # a faster change of the reference is a new setting, not a drive [m/s]
_FEWEST = 8  # ranges whose scatter from sweep to sweep is stated
_DRIVE = 2.0  # a larger change of the reference within a setting makes it a drive [m]
DEFAULT_BIN = 50.0
"""Width of the distance bins into which a drive is sorted [m]."""

REFUSED = Flag.MODEL_MISMATCH | Flag.SIGNAL_QUALITY
"""Flags that a range which the integrity tests refuse has, all of them."""

EXCLUDED = Flag.WEAK_SIGNAL | Flag.MODE_MISMATCH | Flag.OUT_OF_LIMITS
"""Flags with which a range counts in no statistics; a refused one does not either."""


@dataclasses.dataclass(frozen=True)
class SettingStatistics:
    """Ranges of one distance setting; reference and bias are None where no reference was recorded."""

    pair: str
    mode: str  # 'SD' or 'LD'
    reference: float | None  # mean [m]
    n: int
    bias: float | None  # mean of range minus reference [m]
    std: float  # of range minus reference, of the range without a reference [m]; NaN for a single one
    range: float  # mean [m]
    range_std: float  # root mean square of what was reported as standard deviation [m]
    reference_std: float | None  # root mean square of the reference's own standard deviation [m]
    delay: float  # mean delay of the whole path, hardware included [s]
    excluded: int  # sweeps left out: weak signal, stations that disagree on the mode, out of limits, refused
    scatter: float  # standard deviation from sweep to sweep, whatever a steady movement does; NaN for fewer than 8 [m]
    velocity: float | None  # mean; None where it is not known [m/s]
    doppler_std: float  # root mean square of the part of `range_std` by what a velocity may do [m]
    start_frequency: float  # of the sweep [Hz]
    bandwidth: float  # [Hz]


def counts(result: RangeResult) -> bool:
    """Return whether a range counts in statistics."""
    return not result.flags & EXCLUDED and result.flags & REFUSED != REFUSED and math.isfinite(result.range)


def reference_at(reference: Reference, stamps: np.ndarray) -> np.ndarray:
    """Return the reference distance at `stamps` [ns], shape (n,) [m]; NaN where no reading is near enough.

    A reading of the same stamp counts as it is, between readings the distance is interpolated.
    """
    stamps = np.asarray(stamps, dtype=np.int64)
    if not len(reference.stamps):
        return np.full(stamps.shape, np.nan)
    start = reference.stamps[0]
    seconds, wanted = (reference.stamps - start) * 1e-9, (stamps - start) * 1e-9
    after = np.clip(np.searchsorted(reference.stamps, stamps), 0, len(seconds) - 1)
    before = np.clip(after - (reference.stamps[after] > stamps), 0, len(seconds) - 1)
    gap_before, gap_after = np.abs(wanted - seconds[before]), np.abs(seconds[after] - wanted)
    inside = (gap_before <= _INTERPOLATION_LIMIT) & (gap_after <= _INTERPOLATION_LIMIT) & (after != before)
    span = seconds[after] - seconds[before]
    weight = np.divide(wanted - seconds[before], span, out=np.zeros_like(span), where=span > 0)
    between = reference.ranges[before] * (1.0 - weight) + reference.ranges[after] * weight
    nearest = np.where(gap_before <= gap_after, reference.ranges[before], reference.ranges[after])
    beside = np.minimum(gap_before, gap_after) <= _NEAREST_LIMIT
    return np.where(inside, between, np.where(beside, nearest, np.nan))


def setting_statistics(
    results: list[RangeResult], reference: Reference, bin_width: float = DEFAULT_BIN
) -> list[SettingStatistics]:
    """Return one row per distance setting, in order of pair and time; a drive is sorted into distance bins.

    A new setting begins after a pause, with a new mode, with another band, or where the distance jumps.

    Args:
        results: of one replay.
        reference: readings of the reference instrument, may be empty.
        bin_width: of a drive's distance bins [m].
    """
    rows: list[SettingStatistics] = []
    pairs = sorted({(r.first_station, r.second_station) for r in results})
    for pair in pairs:
        own_reference = reference.of('/'.join(pair))
        own = sorted((r for r in results if (r.first_station, r.second_station) == pair), key=lambda r: r.stamp)
        stamps = np.array([r.stamp for r in own], dtype=np.int64)
        truth = reference_at(own_reference, stamps)
        distance = _filled(stamps, np.where(np.isfinite(truth), truth, [r.range for r in own]))
        kinds = np.array([(r.mode, r.start_frequency, r.bandwidth) for r in own])
        settings = _settings(stamps, kinds, distance, has_reference=bool(len(own_reference.stamps)))
        drives: dict[tuple[float, ...], list[int]] = {}
        for setting in settings:
            if np.ptp(distance[setting]) <= _DRIVE:
                rows.append(_row(pair, [own[i] for i in setting], truth[setting], own_reference))
                continue
            for i in setting:
                drives.setdefault((*kinds[i], math.floor(distance[i] / bin_width)), []).append(i)
        rows.extend(
            _row(pair, [own[i] for i in drives[key]], truth[drives[key]], own_reference) for key in sorted(drives)
        )
    return rows


def _filled(stamps: np.ndarray, distance: np.ndarray) -> np.ndarray:
    """Return distances in which a sweep without a line has that of the sweeps around it; zeros where none has one."""
    known = np.isfinite(distance)
    if not known.any():
        return np.zeros(len(distance))
    return np.where(known, distance, np.interp(stamps - stamps[0], stamps[known] - stamps[0], distance[known]))


def _settings(stamps: np.ndarray, kinds: np.ndarray, distance: np.ndarray, has_reference: bool) -> list[np.ndarray]:
    """Return index arrays of the runs of sweeps that belong to one setting; `kinds` (n, 3) is mode and band of each."""
    step = np.diff(stamps) * 1e-9
    new = (step > _PAUSE) | np.any(np.diff(kinds, axis=0) != 0, axis=1)
    if has_reference:
        new |= np.abs(np.diff(distance)) > np.maximum(_FASTEST * step, _DRIVE)
    return np.split(np.arange(len(stamps)), np.flatnonzero(new) + 1)


def _row(
    pair: tuple[str, str], results: list[RangeResult], truth: np.ndarray, reference: Reference
) -> SettingStatistics:
    has_reference = bool(np.isfinite(truth).any())
    chosen = np.array([counts(r) for r in results])
    if has_reference:
        chosen &= np.isfinite(truth)
    excluded = int(len(results) - chosen.sum())
    kept = [r for r, take in zip(results, chosen, strict=True) if take]
    ranges = np.array([r.range for r in kept])
    error = ranges - truth[chosen] if has_reference else ranges
    nothing = math.nan
    velocities = [r.velocity for r in kept if math.isfinite(r.velocity)]
    return SettingStatistics(
        pair='/'.join(pair),
        mode=Mode(results[0].mode).short_name,
        reference=float(np.mean(truth[np.isfinite(truth)])) if has_reference else None,
        n=len(kept),
        bias=(float(np.mean(error)) if kept else nothing) if has_reference else None,
        std=float(np.std(error, ddof=1)) if len(kept) > 1 else nothing,
        range=float(np.mean(ranges)) if kept else nothing,
        range_std=float(np.sqrt(np.mean([r.range_std**2 for r in kept]))) if kept else nothing,
        reference_std=float(np.sqrt(np.mean(reference.stds**2))) if has_reference else None,
        delay=float(np.mean([r.path_delay for r in kept])) if kept else nothing,
        excluded=excluded,
        scatter=float(np.sqrt(np.mean(np.diff(ranges, 2) ** 2) / 6.0)) if len(ranges) >= _FEWEST else nothing,
        velocity=float(np.mean(velocities)) if velocities else None,
        doppler_std=float(np.sqrt(np.mean([r.doppler_std**2 for r in kept]))) if kept else nothing,
        start_frequency=results[0].start_frequency,
        bandwidth=results[0].bandwidth,
    )
