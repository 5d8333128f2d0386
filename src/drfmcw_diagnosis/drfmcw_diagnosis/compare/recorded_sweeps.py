"""Which sweeps of a recording are compared, and their features, group by group."""

import dataclasses
import functools
import itertools

import numpy as np
from numpy.polynomial.legendre import legfit, legval
from scipy import signal

from drfmcw_node.estimators.estimation import Flag
from drfmcw_physics.constants import SPEED_OF_LIGHT
from drfmcw_physics.settings import ConfigurationError
from drfmcw_physics.sweep import beat_frequency

from ..features import uneven_blocks
from ..features.extractor import Extractor, SweepFeatures, as_complex, block_lengths
from ..features.limits import SPECTRUM
from ..features.noise_bands import NoiseBands
from ..features.spectra import mean_power, near_line
from ..recording.dataset import Dataset
from ..recording.grouping import noise_by_bends
from ..recording.topology import Channel
from .groups import Part, steady
from .limits import SCATTER, SWEEPS


class RecordedSweeps:
    """The sweeps of a recording in G groups of the same conditions, by S stations with samples.

    Attributes:
        data: the recording.
        topology: of its stations.
        heard: numbers of the stations with samples (S,).
        members: rows of `data` in each group.
        scatters: the groups have enough sweeps to estimate their scatter.
        unsound: how many sweeps were left out, as their lines were not where they should be.
        whole: groups of which no sweep was left out for that (G,).
        parts: the groups by setting.
        sweeps: features of each group's members, without uneven blocks of the ramp.
        left_out: which blocks these are (G, 2 S, K), see `features.uneven_blocks`.
        shares: of each group's quiet members in the coherence (m, C).
        slope: of the reference in each group (G,) [m/s].
        slope_std: its standard deviation (G,), inf where there is no reference.
        reference_noise: standard deviation of the reference's mean in each group (G,), 0 without reference [m].
        standing: the target stands, by its slope (G,).
        speed: its slope where it drives, 0 where it stands (G,) [m/s].
        way: that it drives in each group at that speed (G,) [m].
        counted: it moves so little from sweep to sweep that the carrier's phase counts its way (G,).
        bands: in which their noise is compared.
    """

    def __init__(self, data: Dataset, rows: np.ndarray | None = None) -> None:
        """Choose the sweeps and extract their features.

        Args:
            data: the recording, of two stations or of one.
            rows: sweeps to use, None for all.

        Raises:
            ConfigurationError: nowhere enough sweeps under the same conditions to estimate their scatter, which two
                stations' oscillators make; few of a station that hears itself count as disturbed by white noise alone,
                but its line must stand clear of 0 Hz.
        """
        self.data, self.topology = data, data.topology
        self.heard = self.topology.heard
        rows = np.arange(len(data)) if rows is None else np.asarray(rows)
        if self.topology.hears_itself:
            rows = rows[(data.lines.flags[0, rows] & Flag.NEAR_DC) == 0]
            if not len(rows):
                raise ConfigurationError(f'{data.path}: no sweep is usable, the line stands too near 0 Hz')
        group = data.group[rows]
        members = [rows[group == g] for g in np.unique(group)]
        self.members = [m for m in members if len(m) >= SCATTER.fewest]
        self.scatters = bool(self.members)
        if not self.scatters:
            if self.topology.is_pair:
                needed = f'needs at least {SCATTER.fewest} sweeps under the same conditions'
                raise ConfigurationError(f'{data.path}: {needed}')
            self.members = members
        self.unsound, self.whole = 0, np.ones(len(self.members), bool)
        self._extract()
        mistaken = self._mistaken()
        sound = [self._sound(g) & ~mistaken[g] for g in range(len(self.members))]
        if self.topology.is_pair and not all(s.all() for s in sound) and any(s.sum() >= SCATTER.fewest for s in sound):
            kept = [m[s] for m, s in zip(self.members, sound, strict=True) if s.sum() >= SCATTER.fewest]
            self.whole = np.array([s.all() for s in sound if s.sum() >= SCATTER.fewest])
            self.unsound = sum(map(len, self.members)) - sum(map(len, kept))
            self.members = kept
            self._extract()
        slope, slope_std = data.velocity, data.velocity_std
        self.slope = np.array([np.nanmean(slope[m]) if np.isfinite(slope[m]).any() else 0.0 for m in self.members])
        known = [np.isfinite(slope_std[m]).any() for m in self.members]
        self.slope_std = np.array(
            [np.nanmean(slope_std[m]) if k else np.inf for m, k in zip(self.members, known, strict=True)]
        )
        self.slope_std = np.maximum(self.slope_std, SWEEPS.exact)
        variance = [
            np.nanmean(data.reference_std[m] ** 2) if np.isfinite(data.reference_std[m]).any() else 0.0
            for m in self.members
        ]
        self.reference_noise = np.sqrt(np.array(variance) / [len(m) for m in self.members])
        speed = np.abs(self.slope) / np.where(known, self.slope_std, np.inf)
        self.standing = speed < SWEEPS.standing
        if not self.standing.all():  # a crane that drives also starts and stops
            self.standing &= speed < SWEEPS.standing_among_drives
        self.speed = np.where(self.standing, 0.0, self.slope)
        self.way = self.speed * np.array([np.ptp(data.time[m]) for m in self.members])
        self.counted = np.array([s and self._is_counted(g) for g, s in enumerate(self.standing)])
        self.bands = NoiseBands(data.sweeps[0][0].sample_rate, self.parts[0].extract.window_power)

    @property
    def time(self) -> np.ndarray:
        """Time of the ramp's blocks in the first station's sweep (K,) [s]."""
        return self.sweeps[0].time

    @property
    def channels(self) -> tuple[Channel, ...]:
        """What each of the ramp's series is (2 S,)."""
        return self.topology.channels

    @property
    def phases(self) -> list[int]:
        """Channels that are phases."""
        return [i for i, channel in enumerate(self.channels) if channel.of_phase]

    @property
    def sample_rate(self) -> float:
        """Sample rate [Hz]."""
        return float(self.data.sweeps[0][0].sample_rate)

    @functools.cached_property
    def distance(self) -> np.ndarray:
        """Mean distance of each group (G,) [m]."""
        return np.array([self.data.distance[m].mean() for m in self.members])

    @functools.cached_property
    def calm(self) -> list[np.ndarray]:
        """Which sweeps of each group hold no burst at any station (n,), all where hardly any is free."""
        return [s.calm | (s.calm.sum() < SPECTRUM.free_sweeps) for s in self.sweeps]

    @functools.cached_property
    def freedom(self) -> np.ndarray:
        """Pairs of calm sweeps' degrees of freedom (G,), as many exponential powers a variance is worth."""
        return np.maximum((np.array([calm.sum() for calm in self.calm]) - 1) / 2, 0.5)

    @functools.cached_property
    def quiet_counts(self) -> np.ndarray:
        """Number of each group's sweeps without a burst (G, S)."""
        return np.array([s.free.sum(axis=0) for s in self.sweeps])

    @functools.cached_property
    def spectra(self) -> list[np.ndarray]:
        """Mean power of each group's sweeps without bursts (S, B) [LSB^2]."""
        return [mean_power(s.power, s.free)[0] for s in self.sweeps]

    def range_error(self, group: int) -> np.ndarray:
        """Return ranges less the reference's of a group's sweeps (n,) [m]."""
        error: np.ndarray = self.sweeps[group].range - self.data.distance[self.members[group]]
        return error

    def range_noise(self, group: int) -> np.ndarray:
        """Return what the ranges of a group's calm sweeps scatter by, less a target's steady course (n,) [m]."""
        error = self.range_error(group)[self.calm[group]]
        free = len(error) - 1
        if self.counted[group] or free <= 2 * SCATTER.course or not np.isfinite(error).all():
            return error
        left = error - _course(error)
        return left * np.sqrt(free / (free - SCATTER.course))

    @functools.cached_property
    def beside_lines(self) -> np.ndarray:
        """Which bins of each group's spectra lie beside the stations' own lines (G, S, B)."""
        bins = self.sweeps[0].power.shape[-1]
        return np.stack([~self.bands.at_line(s.line.mean(axis=0), bins) for s in self.sweeps])

    @functools.lru_cache(maxsize=16)  # noqa: B019 they live as long as the recording is compared
    def alignment(self, station: int, frequency: float) -> float:
        """Return the squared sum of a line's phasors at the start of each sweep over the sum of their squares.

        With random phases it is exponentially distributed with mean 1; with equal ones it is the number of sweeps.

        Args:
            station: its number among those with samples.
            frequency: of the line [Hz].
        """
        heard, iq = self.heard[station], self.topology.iq
        samples = self.data.samples_of(heard)
        count = samples.shape[1] // self.topology.parts
        turns = frequency / self.data.sweeps[0][heard].sample_rate * np.arange(count)
        weights = np.exp(-2j * np.pi * turns) * signal.windows.blackmanharris(count)
        phasors = np.concatenate([as_complex(samples[rows], iq) @ weights for rows in self.members])
        return float(np.abs(phasors.sum()) ** 2 / np.sum(np.abs(phasors) ** 2))

    def _extract(self) -> None:
        """Take the features of all members' sweeps."""
        data = self.data
        settings = np.unique(data.setting[np.concatenate(self.members)])
        self.parts = [self._part(setting) for setting in settings]
        covered = {part.extract.covered for part in self.parts}
        if len(covered) > 1:  # windows of several lengths: blocks of one length, and as many of each
            size = min(block_lengths(max(covered)), key=lambda n: (sum(c % n for c in covered), -n))
            blocks, most = range(size, size + 1), min(covered) // size
            self.parts = [self._part(setting, blocks, most) for setting in settings]
        sweeps: dict[int, SweepFeatures] = {}
        shares: dict[int, np.ndarray] = {}
        for part in self.parts:
            for g in part.groups:
                samples = tuple(data.samples_of(i)[self.members[g]] for i in self.heard)
                scale = float(np.median(data.full_scale[self.heard[0], self.members[g]]))
                sweeps[g] = part.extract(samples, scale, data.refractive_index[self.members[g]])
                shares[g] = part.extract.shared_noise(samples, sweeps[g])
        self.sweeps = [sweeps[g] for g in range(len(self.members))]
        self.shares = [shares[g] for g in range(len(self.members))]
        self.left_out = uneven_blocks.uneven([s.ramp[s.calm] for s in self.sweeps])
        self.sweeps = [
            dataclasses.replace(s, ramp=self.without_uneven(s.ramp, np.full(len(s.ramp), g)))
            for g, s in enumerate(self.sweeps)
        ]

    def without_uneven(self, ramp: np.ndarray, group: np.ndarray) -> np.ndarray:
        """Return the ramps (n, 2 S, K) of sweeps of groups (n,) without the blocks left out there."""
        if not self.left_out.any():
            return ramp
        return uneven_blocks.without(ramp, self.left_out[group], len(self.heard))

    def _sound(self, group: int) -> np.ndarray:
        """Return which sweeps of a group have their lines where they should be, clear of 0 Hz and of Nyquist (n,).

        Neither are few of them far weaker than the others: something stood in the way. No sweep of a group is sound
        whose lines hardly stand out of the noise, or of another line: to take the strongest would raise the mean power.
        """
        sweeps, rate = self.sweeps[group], self.data.sweeps[0][0].sample_rate
        # a line that is expected beyond the Nyquist frequency folds back into the ramp's band
        lines = np.concatenate([sweeps.line, self._expected_lines(group)[None]])
        clear = np.all((lines > SWEEPS.nearest_line) & (lines < rate / 2 - SWEEPS.nearest_line), axis=1)
        clear = clear[:-1] & clear[-1]
        error = self.range_error(group)
        error = np.abs(error - np.median(error))
        clear &= error < max(SWEEPS.astray, SWEEPS.astray_spreads * float(np.median(error)))
        over_noise, over_others = _standing_out(sweeps, rate)
        clear &= bool(np.all(np.median(over_noise, axis=0) > SWEEPS.least_line))
        clear &= bool(np.all(np.median(over_others, axis=0) > SWEEPS.least_over_others))
        apart = np.abs(sweeps.amplitude - np.median(sweeps.amplitude, axis=0))
        faded = np.any(apart > np.maximum(SWEEPS.faded, SWEEPS.faded_spreads * np.median(apart, axis=0)), axis=1)
        return clear & ~(faded & (np.mean(faded) < SWEEPS.faded_share))

    def _mistaken(self) -> np.ndarray:
        """Return the groups in which another line passes for one of the stations' own (G,), as a strong spur may.

        It moves range and beat frequency together, as nothing else does, beside the group whose range is nearest to the
        reference.
        """
        found = np.zeros(len(self.members), bool)
        if not self.topology.both_heard:
            return found
        error = np.array([np.median(self.range_error(g)) for g in range(len(self.members))])
        if not np.isfinite(error).any():
            return found
        turned, of_way = np.zeros(len(found)), np.zeros(len(found))
        for part in self.parts:
            of_way[part.groups] = 2.0 * abs(part.extract.sweeps[0].chirp_rate) / SPEED_OF_LIGHT
            for g in part.groups:
                first, second = self._expected_lines(g)
                turned[g] = np.median(self.sweeps[g].beat) - (first + part.extract.sign * second)
        nearest = np.nanargmin(np.abs(error))
        moved = np.abs(error - error[nearest])
        return (moved > SWEEPS.mistaken) & (np.abs(turned - turned[nearest]) > moved * of_way / 2.0)

    def _is_counted(self, group: int) -> bool:
        """Return whether a target that stands by its reference moves less than the carrier's phase is ambiguous by.

        One that sways may pass wavelengths from sweep to sweep. The ranges show it, beyond the noise in their bends.
        """
        error = self.range_error(group)
        way = np.pi * abs(self.parts[0].extract.way_per_phase)
        if len(error) < SCATTER.wander_sweeps or not way or not np.isfinite(error).all():
            return True
        noise, least = noise_by_bends(error), SCATTER.ambiguous * way
        fast = np.mean(np.diff(error) ** 2) - 2.0 * noise**2 > max(SCATTER.beyond_noise * 2.0 * noise**2, least**2)
        slow = np.diff(_course(error))
        return not fast and float(np.mean(slow**2)) < max(SCATTER.of_course * noise / len(error) ** 1.5, least) ** 2

    def _expected_lines(self, group: int) -> np.ndarray:
        """Return where the nominal model has a group's lines (S,) [Hz]."""
        part = next(p for p in self.parts if group in p.groups)
        delay = float(part.steady.paths[0].delay[part.groups == group][0])
        sweeps, calibrated = part.extract.sweeps, self.data.calibration
        return np.array(
            [beat_frequency(sweeps[i], delay, calibrated[i].alpha, calibrated[-1 - i].alpha) for i in self.heard]
        )

    def _part(self, setting: int, blocks: range | None = None, most: int | None = None) -> Part:
        """Return the groups of one setting and their nominal conditions; `blocks` and `most` as for `Extractor`."""
        data = self.data
        groups = np.array([g for g, m in enumerate(self.members) if data.setting[m[0]] == setting])
        counts = [len(self.members[g]) for g in groups]
        starts = np.concatenate([[0], np.cumsum(counts)])
        local = [np.arange(a, b) for a, b in itertools.pairwise(starts)]
        nominal = data.nominal(np.concatenate([self.members[g] for g in groups]))
        extract = Extractor(data.sweeps[setting], data.calibration, data.topology, blocks, most)
        return Part(groups, local, nominal, steady(nominal, local), extract)


def _standing_out(sweeps: SweepFeatures, rate: float) -> tuple[np.ndarray, np.ndarray]:
    """Return the power of each sweep's lines over that of the noise in a bin, and over any other line's (n, S).

    Args:
        sweeps: features of a group.
        rate: of the samples [Hz].
    """
    power, bins = sweeps.power, sweeps.power.shape[-1]
    width = rate / 2.0 / (bins - 1)
    at = np.clip(np.rint(np.abs(sweeps.line) / width).astype(int), 0, bins - 1)
    line = np.take_along_axis(power, at[..., None], axis=-1)[..., 0]
    noise = np.median(power, axis=-1) / np.log(2.0)  # powers of noise are exponentially distributed
    other = np.where(near_line(bins, np.abs(sweeps.line), width, rate), 0.0, power).max(axis=-1)
    return line / np.maximum(noise, 1e-30), line / np.maximum(other, 1e-30)


def _course(values: np.ndarray) -> np.ndarray:
    """Return the smooth course of a group's values (n,)."""
    place = np.linspace(-1.0, 1.0, len(values))
    course: np.ndarray = legval(place, legfit(place, values, SCATTER.course))
    return course
