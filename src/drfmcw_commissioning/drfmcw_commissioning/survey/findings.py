"""What the sweeps of a pair say together: distance bins, availability, gaps and rates, and where the link suffers."""

import dataclasses
import math

import numpy as np

from drfmcw_node.estimators.estimation import Flag as BeatFlag

from .evidence import PairEvidence, StationEvidence
from .requirements import Requirements

DETECTION = 15.5
"""Signal-to-noise ratio that noise alone reaches once in 1e6 sweeps with a Hann window (docs/integrity.md) [dB]."""
_FADING_QUANTILE = 0.01  # of the sweeps, below which the fading margin does not look
_MULTIPATH_STD = 1.5  # sweeps of one path scatter by some tenths of a dB [dB]
_MULTIPATH_CORRELATION = 0.5  # both stations share the path, and so its fading
_MULTIPATH_SWINGS = 4  # of the power over the distance; a step down and up again is an obstacle
_GROUPS = 64  # of neighbouring sweeps, between which swings are counted
_SHADOWING = 6.0  # below the median of the travel: half of the first Fresnel zone is blocked (ITU-R P.526) [dB]
_ONE_SIDED = 3.0  # between the stations: reciprocity allows none [dB]
_NOISE_RISE = 3.0  # above the travel's median: as much power from others as from the receiver [dB]
_FEWEST = 8  # sweeps for a statement about scatter
_PAUSE = 2.0  # a longer one between sweeps in order is a pause of the measurement, not a gap [s]
_WINDOW = 1.0  # in which ranges are counted for the rate [s]
_LONGEST_RUN = 1000  # of sweeps missing in a row; more is a new numbering
_CONFIDENCE = 0.95
_DISTURBED = int(BeatFlag.BURST | BeatFlag.AMBIGUOUS)


@dataclasses.dataclass(frozen=True)
class BinFinding:
    """One distance bin of one pair."""

    begin: float  # [m]
    end: float  # [m]
    sweeps: int
    usable: float  # share of them
    bias: float  # mean error of the usable ranges, NaN without a reference [m]
    std: float  # of the error, of the range without a reference [m]
    reported_std: float  # root mean square [m]
    excess: tuple[float, ...]  # received power over free space, mean of each station [dB]
    fading: float  # standard deviation of the received power, trend removed [dB]
    margin: float  # of the weaker line over detection in 99 % of the sweeps [dB]
    disturbed: float  # share of sweeps with bursts or a second line
    reasons: tuple[str, ...]  # why the link suffers here

    @property
    def middle(self) -> float:
        """Return its distance [m]."""
        return 0.5 * (self.begin + self.end)

    @property
    def distances(self) -> str:
        """Return its distances in words."""
        return f'{self.begin:g} to {self.end:g} m'


@dataclasses.dataclass(frozen=True)
class BoardFinding:
    """The board of one station."""

    station: str
    distance: float  # largest, from the range of the calibration, or from its temperature where it states none [K]
    within: tuple[float, float] | None  # the range [degC]


@dataclasses.dataclass(frozen=True)
class PairFinding:
    """One pair on the whole travel; NaN stands for what cannot be determined."""

    pair: str
    sweeps: int  # that the numbers of the first and the last say there were
    usable: int
    accuracy: float  # error that `accuracy_share` of the usable ranges stay within [m]
    compared: int  # usable ranges with a reference
    wrong: int  # of these beyond the protection level
    lowest_rate: float  # usable ranges in the poorest second [Hz]
    median_rate: float  # [Hz]
    longest_gap: float  # [s]
    clock_difference: float  # median [ppm]
    boards: tuple[BoardFinding, ...]  # of each station
    travel: tuple[float, float]  # [m]
    covered: float  # share of the travel that lies in bins with enough usable ranges
    bins: tuple[BinFinding, ...]

    @property
    def availability(self) -> float:
        """Return the share of the sweeps with a usable range."""
        return self.usable / self.sweeps if self.sweeps else math.nan

    def judged_bins(self, count: int) -> list[BinFinding]:
        """Return the bins with at least `count` sweeps."""
        return [b for b in self.bins if b.sweeps >= count]


def find(pair: PairEvidence, requirements: Requirements) -> PairFinding:
    """Return what the sweeps of a pair say together."""
    usable = pair.usable
    error = np.abs(pair.error[usable])
    known = np.isfinite(error)
    bound = pair.protection_level[usable] + 3.0 * pair.reference_std[usable]
    bins, travel = _bins(pair, requirements)
    rates = _rates(pair.stamps, usable)
    return PairFinding(
        pair=pair.pair,
        sweeps=_expected_sweeps(pair.sweep_ids),
        usable=int(usable.sum()),
        accuracy=float(np.quantile(error[known], requirements.accuracy_share)) if known.any() else math.nan,
        compared=int(known.sum()),
        wrong=int((error[known] > bound[known]).sum()),
        lowest_rate=float(rates.min()) if len(rates) else math.nan,
        median_rate=float(np.median(rates)) if len(rates) else math.nan,
        longest_gap=_longest_gap(pair.stamps, pair.sweep_ids, usable),
        clock_difference=_median(pair.clock_difference[usable]),
        boards=tuple(_board(station) for station in pair.stations),
        travel=travel,
        covered=_covered(bins, travel, requirements.bin_count),
        bins=bins,
    )


def _median(values: np.ndarray) -> float:
    kept = values[np.isfinite(values)]
    return float(np.median(kept)) if len(kept) else math.nan


def _expected_sweeps(numbers: np.ndarray) -> int:
    """Return how many sweeps there were by their numbers; a jump of the numbering counts as one sweep."""
    steps = np.diff(numbers)
    return int(1 + np.where((steps >= 1) & (steps <= _LONGEST_RUN), steps, 1).sum()) if len(numbers) else 0


def _runs(stamps: np.ndarray) -> list[np.ndarray]:
    """Return index arrays of the sweeps between pauses."""
    return np.split(np.arange(len(stamps)), np.flatnonzero(np.diff(stamps) * 1e-9 > _PAUSE) + 1)


def _rates(stamps: np.ndarray, usable: np.ndarray) -> np.ndarray:
    """Return the number of usable ranges in each whole second between pauses [Hz]."""
    counts = []
    for run in _runs(stamps):
        seconds = (stamps[run] - stamps[run[0]]) * 1e-9
        whole = math.floor((seconds[-1] + 1e-6) / _WINDOW) if len(run) else 0
        if len(run) > 1:  # a sweep's own interval belongs to the second as well
            whole = math.floor((seconds[-1] + float(np.median(np.diff(seconds))) + 1e-6) / _WINDOW)
        window = np.floor(seconds / _WINDOW).astype(int)
        chosen = usable[run] & (window < whole)
        counts.append(np.bincount(window[chosen], minlength=whole)[:whole] / _WINDOW)
    return np.concatenate(counts) if counts else np.array([])


def _longest_gap(stamps: np.ndarray, numbers: np.ndarray, usable: np.ndarray) -> float:
    """Return the longest time between two usable ranges with sweeps between them that gave none [s]."""
    good = np.flatnonzero(usable)
    if len(good) < 2:
        return math.inf if len(stamps) else math.nan
    between = np.diff(numbers[good]) > 1
    times = np.diff(stamps[good]) * 1e-9
    normal = float(np.median(np.diff(stamps))) * 1e-9
    return float(times[between].max()) if between.any() else normal


def _board(station: StationEvidence) -> BoardFinding:
    """Return how warm a board was beside its calibration, by the rule that fusion flags ranges by."""
    temperatures = station.temperatures[np.isfinite(station.temperatures)]
    coldest, warmest = station.calibrated_within
    if station.states_range:
        distances = np.maximum(0.0, np.maximum(coldest - temperatures, temperatures - warmest))
    else:
        distances = np.abs(temperatures - station.calibrated_at)
    distance = float(distances.max()) if len(distances) else math.nan
    return BoardFinding(station.name, distance, (coldest, warmest) if station.states_range else None)


def _covered(bins: tuple[BinFinding, ...], travel: tuple[float, float], count: int) -> float:
    """Return the share of the travel that lies in bins with at least `count` usable ranges."""
    enough = [b for b in bins if round(b.usable * b.sweeps) >= count]
    length = travel[1] - travel[0]
    if not length > 0.0:  # a crane that stood
        return float(bool(enough))
    return sum(max(0.0, min(b.end, travel[1]) - max(b.begin, travel[0])) for b in enough) / length


def _bins(pair: PairEvidence, requirements: Requirements) -> tuple[tuple[BinFinding, ...], tuple[float, float]]:
    """Return the bins of the travel that hold sweeps, and the travel."""
    distance, width = pair.distance, requirements.bin_width
    believed = np.isfinite(distance) & (np.isfinite(pair.reference) | pair.usable)
    if not believed.any():
        return (), (math.nan, math.nan)
    low = float(distance[believed].min()) if math.isnan(requirements.travel_begin) else requirements.travel_begin
    high = float(distance[believed].max()) if math.isnan(requirements.travel_end) else requirements.travel_end
    inside = believed & (distance >= low) & (distance <= high)
    number = np.floor(distance / width, where=inside, out=np.full(len(distance), -1.0)).astype(int)
    levels = tuple((_median(s.excess[inside]), _median(s.noise[inside])) for s in pair.stations)
    found = [_bin(pair, np.flatnonzero(inside & (number == n)), n, width, levels) for n in np.unique(number[inside])]
    return tuple(found), (low, high)


def _bin(
    pair: PairEvidence, rows: np.ndarray, number: int, width: float, levels: tuple[tuple[float, float], ...]
) -> BinFinding:
    good = rows[pair.usable[rows]]
    error = pair.error[good]
    has_reference = bool(np.isfinite(error).any())
    values = error[np.isfinite(error)] if has_reference else pair.range[good]
    snr = np.min([s.snr[rows] for s in pair.stations], axis=0)
    flags = np.bitwise_or.reduce([s.flags[rows] for s in pair.stations])
    disturbed = float(np.mean(flags & _DISTURBED != 0))
    fading = [_without_trend(pair.distance[rows], s.excess[rows]) for s in pair.stations]
    means = tuple(_mean(s.excess[rows]) for s in pair.stations)
    return BinFinding(
        begin=float(number * width),
        end=float((number + 1) * width),
        sweeps=len(rows),
        usable=len(good) / len(rows),
        bias=float(np.mean(values)) if has_reference else math.nan,
        std=float(np.std(values, ddof=1)) if len(values) > 1 else math.nan,
        reported_std=float(np.sqrt(np.mean(pair.range_std[good] ** 2))) if len(good) else math.nan,
        excess=means,
        fading=_largest([float(np.std(f)) for f in fading if len(f) >= _FEWEST]),
        margin=float(np.quantile(snr, _FADING_QUANTILE)) - DETECTION,
        disturbed=disturbed,
        reasons=tuple(_reasons(pair, rows, fading, means, levels, disturbed)),
    )


def _mean(values: np.ndarray) -> float:
    kept = values[np.isfinite(values)]
    return float(np.mean(kept)) if len(kept) else math.nan


def _largest(values: list[float]) -> float:
    return max(values) if values else math.nan


def _without_trend(distance: np.ndarray, excess: np.ndarray) -> np.ndarray:
    """Return the received power over free space without its mean and its slope over the distance [dB]."""
    known = np.isfinite(excess)
    x, y = distance[known], excess[known]
    if len(y) < _FEWEST:
        return np.array([])
    spread = float(np.std(x))
    scaled = (x - x.mean()) / spread if spread > 1e-3 else np.zeros(len(x))
    return y - y.mean() - scaled * float(np.mean(scaled * y))


def _swings(distance: np.ndarray, power: np.ndarray) -> int:
    """Return how often the power crosses its mean over the distance, smoothed over neighbouring sweeps."""
    ordered = power[np.argsort(distance, kind='stable')]
    groups = np.array([float(np.mean(part)) for part in np.array_split(ordered, min(_GROUPS, len(ordered)))])
    clear = groups[np.abs(groups) > _MULTIPATH_STD / 2.0]  # noise about the mean is no swing
    return int(np.count_nonzero(np.diff(np.sign(clear))))


def _reasons(
    pair: PairEvidence,
    rows: np.ndarray,
    fading: list[np.ndarray],
    means: tuple[float, ...],
    levels: tuple[tuple[float, float], ...],
    disturbed: float,
) -> list[str]:
    """Return why the link suffers in a bin; empty where it does not."""
    found = []
    if len(fading) == 2 and len(fading[0]) == len(fading[1]) >= _FEWEST:
        stds = [float(np.std(f)) for f in fading]
        swings = _swings(pair.distance[rows], fading[0] + fading[1])
        together = min(stds) > _MULTIPATH_STD and swings >= _MULTIPATH_SWINGS
        if together and np.corrcoef(fading[0], fading[1])[0, 1] > _MULTIPATH_CORRELATION:
            found.append(f'multipath: the power of both stations fades together by {max(stds):.1f} dB')
    below = [median - mean for mean, (median, _) in zip(means, levels, strict=True)]
    if below and min(below) > _SHADOWING:
        found.append(f'shadowing: both stations receive {min(below):.0f} dB less than elsewhere')
    elif len(below) == 2 and abs(below[0] - below[1]) > _ONE_SIDED:
        weak = int(below[1] > below[0])
        found.append(f"'{pair.stations[weak].name}' receives {abs(below[0] - below[1]):.0f} dB less than its peer")
    for station, (_, noise) in zip(pair.stations, levels, strict=True):
        rise = _median(station.noise[rows]) - noise
        if rise > _NOISE_RISE:
            found.append(f"interference: the noise of '{station.name}' is {rise:.0f} dB higher than elsewhere")
    if disturbed > 0.0:
        found.append(f'interference: bursts or a second line in {disturbed:.1%} of the sweeps')
    return found


def worst(finding: PairFinding, count: int) -> list[tuple[BinFinding, str]]:
    """Return the bins to look at first, each with what is worst there, at most `count`."""
    ranked: list[tuple[float, BinFinding, str]] = []
    for b in finding.bins:
        text = [*b.reasons]
        score = 10.0 * (1.0 - b.usable) + len(b.reasons)
        if b.usable < 1.0:
            text.append(f'{1.0 - b.usable:.1%} of the sweeps give no usable range')
        if math.isfinite(b.bias) and b.reported_std > 0.0:
            score += abs(b.bias) / 0.01
            text.append(f'mean error {1e3 * b.bias:+.1f} mm')
        score += max(0.0, 20.0 - b.margin) / 10.0
        text.append(f'margin {b.margin:.0f} dB')
        ranked.append((score, b, '; '.join(text)))
    ranked.sort(key=lambda entry: -entry[0])
    return [(b, text) for _, b, text in ranked[:count]]
