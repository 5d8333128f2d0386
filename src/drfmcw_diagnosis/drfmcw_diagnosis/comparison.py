"""A recording beside its model: one vector of residuals over their standard deviations, and what effects add to it."""

import dataclasses
import functools
import itertools
import warnings
from collections.abc import Sequence

import numpy as np
from scipy.ndimage import uniform_filter1d

from drfmcw_node.noise import QUANTISATION
from drfmcw_physics.constants import SPEED_OF_LIGHT
from drfmcw_physics.settings import ConfigurationError
from drfmcw_sim.effects import Effect
from drfmcw_sim.signal_model import Measurements, synthesise

from .dataset import Dataset
from .features import (
    BANDS,
    LINE,
    Extractor,
    SweepFeatures,
    gaussian,
    local_noise,
    median_of_mean,
    near_line,
    ramp_spectrum,
)

FEWEST = 3
"""Sweeps of a group that tell their scatter; smaller groups are left out."""

_FREE = 2  # cosine terms that amplitude, phase and frequency of each sweep take out of the ramp
_SMOOTH = 15  # neighbouring cosine terms that share a variance
_FLOOR_LIMIT = 0.02  # what the model of a white floor is trusted to [dB]
_SKIRT_LIMIT = 0.1  # and that of the oscillators' skirts [dB]
_AMPLITUDE_LIMIT = 0.02  # what the link budget is trusted to [dB]
_AMPLITUDE_SHARED = 1.4  # both stations' amplitudes scatter together, which counts their sum twice
_MOVEMENT_LIMIT = 1e-5  # what the carrier phase is trusted to [m]
_BEAT_LIMIT = 10.0  # what T_off is trusted to on average, in beat frequency [Hz]
_STANDING = 4.0  # standard deviations of the reference's slope within which a group stands
_POOL = 30.0  # sweeps that the scatter in all groups counts for in each
_NOTICED = 1e-3  # of the noise, below which a line leaves the median of its band alone
_RAISED = 1.5  # of the noise, where the median around a bin counts as raised by lines
_DISTORTED = 12  # sweeps simulated per group where an effect distorts the IF
_LARGEST = 1e4  # whitened residual beyond which a number says no more


@dataclasses.dataclass(frozen=True)
class Entries:
    """What the numbers of the vector are; arrays (n,)."""

    kind: np.ndarray  # 'ramp', 'lines', 'mean', 'noise', 'beat', 'amplitude', 'range', 'velocity', 'movement'
    station: np.ndarray  # number of the station, -1 for the pair; of ramp: 0, 1 log amplitudes, 2 sum, 3 difference
    group: np.ndarray
    position: np.ndarray  # cosine term, bin, band or sweep

    def where(self, **wanted) -> np.ndarray:
        """Return which entries have all the values given."""
        chosen = np.ones(len(self.kind), bool)
        for name, value in wanted.items():
            chosen &= np.isin(getattr(self, name), value)
        return chosen

    def kinds(self) -> list[tuple[str, int]]:
        """Return kinds with the stations each may have, in order."""
        return [(str(k), int(s)) for k in dict.fromkeys(self.kind) for s in np.unique(self.station)]


@dataclasses.dataclass(frozen=True)
class Groups:
    """Features of each of G groups, measured or predicted."""

    ramp: np.ndarray  # (G, 4, K) cosine series, mean over the group
    lines: np.ndarray  # (G, 2, B) power of narrow lines over the noise around [1]; 1 for none
    mean: np.ndarray  # (G, 2) [LSB]
    noise: np.ndarray  # (G, 2, BANDS) [dB of 1 LSB^2 per sample]
    beat: np.ndarray  # (G,) [Hz]
    amplitude: np.ndarray  # (G, 2) [dB of 1 LSB]
    range: np.ndarray  # (G,) beyond the reference [m]
    velocity: np.ndarray  # (G,) slope of the reference [m/s]
    movement: np.ndarray  # (n sweeps,) within the group [m]


@dataclasses.dataclass(frozen=True)
class _Part:
    """The groups of one setting of the sweep."""

    groups: np.ndarray  # their places among all
    local: list[np.ndarray]  # rows of `all` of each
    all: Measurements  # nominal, one per sweep
    steady: Measurements  # nominal, one per group under its mean conditions
    extract: Extractor


class Comparison:
    """Measured features, their standard deviations, and predictions of the simulator's forward model."""

    def __init__(self, data: Dataset, rows: np.ndarray | None = None) -> None:
        """Extract the features of a recording.

        Args:
            data: the recording, of two stations.
            rows: sweeps to use, None for all.

        Raises:
            ConfigurationError: nowhere enough sweeps under the same conditions to tell their scatter.
        """
        self.data = data
        rows = np.arange(len(data)) if rows is None else np.asarray(rows)
        group = data.group[rows]
        members = [rows[group == g] for g in np.unique(group)]
        self.members = [m for m in members if len(m) >= FEWEST]
        if not self.members:
            raise ConfigurationError(f'{data.path}: needs at least {FEWEST} sweeps under the same conditions')
        self.parts = [self._part(setting) for setting in np.unique(data.setting[np.concatenate(self.members)])]
        self.sweeps: list[SweepFeatures] = [None] * len(self.members)
        for part in self.parts:
            for g in part.groups:
                samples = tuple(x[self.members[g]] for x in data.samples)
                scale = float(np.median(data.full_scale[0, self.members[g]]))
                self.sweeps[g] = part.extract(samples, scale, data.refractive_index[self.members[g]])
        self.time = self.sweeps[0].time
        slope, slope_std = data.velocity, data.velocity_std
        self.slope = np.array([np.nanmean(slope[m]) if np.isfinite(slope[m]).any() else 0.0 for m in self.members])
        known = [np.isfinite(slope_std[m]).any() for m in self.members]
        self.slope_std = np.array(
            [np.nanmean(slope_std[m]) if k else np.inf for m, k in zip(self.members, known, strict=True)]
        )
        self.standing = np.abs(self.slope) < _STANDING * np.where(known, self.slope_std, np.inf)
        self.measured, self.std = self._measure()
        self._plain_power: dict[int, np.ndarray] = {}
        self.plain = self.predict(())
        self.std = dataclasses.replace(self.std, noise=np.hypot(self.std.noise, self._noise_limit()))
        self.entries = self._layout()
        self.residual = self._vector(self.measured)

    def _part(self, setting: int) -> _Part:
        """Return the groups of one setting and their nominal conditions."""
        data = self.data
        groups = np.array([g for g, m in enumerate(self.members) if data.setting[m[0]] == setting])
        counts = [len(self.members[g]) for g in groups]
        starts = np.concatenate([[0], np.cumsum(counts)])
        local = [np.arange(a, b) for a, b in itertools.pairwise(starts)]
        nominal = data.nominal(np.concatenate([self.members[g] for g in groups]))
        return _Part(groups, local, nominal, _steady(nominal, local), Extractor(data.sweeps[setting], data.calibration))

    # --- the recording ---

    def _measure(self) -> tuple[Groups, Groups]:
        """Return the measured features of all groups and their standard deviations."""
        errors_of_range = [s.range - self.data.distance[m] for s, m in zip(self.sweeps, self.members, strict=True)]
        expected = [
            np.mean(s.range_std**2 + np.nan_to_num(self.data.reference_std[m]) ** 2)
            for s, m in zip(self.sweeps, self.members, strict=True)
        ]
        range_std = _pooled([e[:, None] for e in errors_of_range], np.array(expected))[:, 0]
        beat_std = _pooled([s.beat[:, None] for s in self.sweeps])[:, 0]
        amplitude_std = _pooled([s.amplitude for s in self.sweeps])
        values: list[Groups] = []
        errors: list[Groups] = []
        for g, (rows, sweeps, standing) in enumerate(zip(self.members, self.sweeps, self.standing, strict=True)):
            n = len(rows)
            root = np.sqrt(n)
            ramp = ramp_spectrum(sweeps.ramp)
            variance = uniform_filter1d(ramp[..., _FREE:].var(axis=0, ddof=1), _SMOOTH, mode='nearest', axis=-1)
            ramp_std = np.full(ramp.shape[1:], np.inf)
            ramp_std[:, _FREE:] = np.sqrt(variance / n)
            power = sweeps.power.mean(axis=0)
            around = local_noise(power) / median_of_mean(n)
            noise, noise_std = self._bands(power, sweeps.line.mean(axis=0), n)
            error = errors_of_range[g]
            movement, movement_std = self._movement(sweeps, standing)
            values.append(
                Groups(
                    ramp.mean(axis=0),
                    power / around,
                    sweeps.mean.mean(axis=0),
                    noise,
                    sweeps.beat.mean(),
                    sweeps.amplitude.mean(axis=0),
                    error.mean(),
                    self.slope[g],
                    movement,
                )
            )
            errors.append(
                Groups(
                    ramp_std,
                    around,
                    np.maximum(sweeps.mean.std(axis=0, ddof=1), 0.01) / root,
                    noise_std,
                    np.hypot(beat_std[g] / root, _BEAT_LIMIT),
                    np.hypot(_AMPLITUDE_SHARED * amplitude_std[g] / root, _AMPLITUDE_LIMIT),
                    max(range_std[g], 1e-5) / root,
                    self.slope_std[g],
                    movement_std,
                )
            )
        return _joined(values), _joined(errors)

    def _noise_limit(self) -> np.ndarray:
        """Return what the model of the noise in bands is trusted to (G, 2, BANDS) [dB]: less where a skirt rules."""
        limit = np.empty(self.plain.noise.shape)
        for part in self.parts:
            floor = np.array([s.noise_std() ** 2 + QUANTISATION for s in part.steady.stations]).T
            share = 1.0 - floor[..., None] / 10.0 ** (self.plain.noise[part.groups] / 10.0)
            limit[part.groups] = _FLOOR_LIMIT + _SKIRT_LIMIT * np.clip(share, 0.0, 1.0)
        return limit

    def _bands(self, power: np.ndarray, line: np.ndarray, count: int) -> tuple[np.ndarray, np.ndarray]:
        """Return the noise of each station in bands [dB of 1 LSB^2 per sample] and its deviation, (2, BANDS) each."""
        bins = power.shape[-1]
        masked = self._at_line(line, bins)
        noise, std = np.full((2, BANDS), np.nan), np.full((2, BANDS), np.inf)
        edges = _band_edges(bins)
        extractor = self.parts[0].extract
        for station in range(2):
            for band in range(BANDS):
                inside = power[station, edges[band] : edges[band + 1]]
                inside = inside[~masked[station, edges[band] : edges[band + 1]]]
                if len(inside) < 16:
                    continue
                median = np.median(inside) / median_of_mean(count)
                noise[station, band] = 10.0 * np.log10(median / extractor.window_power[station])
                # neighbouring bins of a Hann window share half of their noise; a median has 1.25 times the mean's
                std[station, band] = 4.34 * 1.25 * np.sqrt(1.9 / (len(inside) * count))
        return noise, std

    def _movement(self, sweeps: SweepFeatures, standing: bool) -> tuple[np.ndarray, np.ndarray]:
        """Return the displacement within a group by the carrier phase [m] (n,), and its deviation: inf on a drive."""
        wave = SPEED_OF_LIGHT / self.data.sweeps[0][0].center_frequency / (4.0 * np.pi)
        turned = np.unwrap(sweeps.carrier) * wave
        std = np.hypot(sweeps.phase_std * wave, _MOVEMENT_LIMIT)
        return turned - turned.mean(), std if standing else np.full(len(turned), np.inf)

    # --- the model ---

    def predict(self, effects: Sequence[Effect]) -> Groups:
        """Return the features that the model with `effects` predicts, from noise-free samples of the simulator."""
        return self._predict(tuple(effects))

    @functools.lru_cache(maxsize=64)  # noqa: B019 the comparison lives as long as its predictions are wanted
    def _predict(self, effects: tuple[Effect, ...]) -> Groups:
        found: list[Groups] = [None] * len(self.members)
        for part in self.parts:
            state = part.steady.rows(slice(None))
            for effect in sorted(effects, key=lambda e: e.stage):
                effect.prepare(state)
            features = self._simulated(part, effects)
            reference = self._reference(part, effects)
            displacement = self._displacement(part, effects)
            quiet = self._predicted_noise(state, features.line, features.amplitude)
            velocity = self._velocity(part.steady, effects)
            distorting = any(e.distorts() for e in effects)
            changed = self._changed_noise(part, effects) if distorting else np.zeros_like(quiet)
            if not effects:
                self._plain_power |= dict(zip(part.groups.tolist(), features.power, strict=True))
            for row, g in enumerate(part.groups.tolist()):
                added = np.maximum(features.power[row] - self._plain_power[g], 0.0).astype(float)
                added[self._at_line(features.line[row], added.shape[-1])] = 0.0
                noise, floor = self._raised(quiet[row], added, features.line[row])
                around = np.ones(added.shape)
                if distorting:
                    noise = self.plain.noise[g] + changed[row]
                    # where harmonics raise the median around, the noise itself is what they add to
                    raised = self.std.lines[g] > _RAISED * floor
                    around[raised] = (floor / self.std.lines[g])[raised]
                found[g] = Groups(
                    ramp_spectrum(features.ramp[row]),
                    around + added / self.std.lines[g],
                    features.mean[row],
                    noise,
                    features.beat[row],
                    features.amplitude[row],
                    features.range[row] - reference[row],
                    velocity[row],
                    displacement[row],
                )
        return _joined(found)

    def _simulated(self, part: _Part, effects: Sequence[Effect]) -> SweepFeatures:
        """Return the features of one noise-free sweep pair per group.

        Mean of sweeps whose phases lie evenly over half a turn: what mirror lines and harmonics leak cancels in them,
        as it does in a recording's sweeps of random phase.
        """
        distorting = any(effect.distorts() for effect in effects)
        copies, count = _DISTORTED if distorting else 2, len(part.groups)
        rows = part.steady.rows(np.tile(np.arange(count), copies))
        rows.initial_phase[0] += np.repeat(np.arange(copies) / (2.0 * copies), count)
        features = self._mean_features(part, rows, effects, copies)
        if distorting:
            features = dataclasses.replace(features, power=self._distorted(part, effects, False).power)
        return features

    def _mean_features(
        self, part: _Part, rows: Measurements, effects: Sequence[Effect], copies: int, noise: bool = False
    ) -> SweepFeatures:
        """Return features of simulated sweeps, each the mean of its copies."""
        samples = synthesise(rows, 0, effects, noise=noise, quantised=False)
        features = part.extract(samples, rows.stations[0].full_scale, rows.refractive_index)
        count = len(part.groups)
        means = {
            f.name: getattr(features, f.name).reshape(copies, count, *getattr(features, f.name).shape[1:]).mean(axis=0)
            for f in dataclasses.fields(SweepFeatures)
            if f.name not in ('time', 'carrier')
        }
        return dataclasses.replace(features, **means, carrier=features.carrier[:count])

    def _distorted(self, part: _Part, effects: Sequence[Effect], noise: bool) -> SweepFeatures:
        """Return mean features of sweeps with the start delays of measured ones, whose jitter harmonics multiply."""
        copies, count = _DISTORTED, len(part.groups)
        rows = part.steady.rows(np.tile(np.arange(count), copies))
        rows.sweep_id = np.arange(len(rows))
        delays = np.stack([self._start_delays(g, copies) for g in part.groups], axis=1)
        rows.start_delay += delays.ravel()
        return self._mean_features(part, rows, effects, copies, noise)

    def _changed_noise(self, part: _Part, effects: Sequence[Effect]) -> np.ndarray:
        """Return by how much distortion changes the noise in bands (G, 2, BANDS) [dB]: a limiter holds noise down."""
        levels = []
        for acting in (effects, ()):
            features = self._distorted(part, acting, True)
            levels.append(
                [self._bands(p, line, _DISTORTED)[0] for p, line in zip(features.power, features.line, strict=True)]
            )
        return np.nan_to_num(np.array(levels[0]) - np.array(levels[1]))

    def _start_delays(self, group: int, count: int) -> np.ndarray:
        """Return deviations of T_off from the group's mean, of `count` of its sweeps [s]."""
        beat = self.sweeps[group].beat
        chosen = beat[np.linspace(0, len(beat) - 1, count).astype(int)]
        sweep = self.data.sweeps[self.data.setting[self.members[group][0]]][0]
        return (chosen - beat.mean()) / (2.0 * abs(sweep.chirp_rate))

    def _at_line(self, line: np.ndarray, bins: int) -> np.ndarray:
        """Return which bins (2, B) are left to the features of the lines themselves; `line` (2,) [Hz]."""
        rate = self.data.sweeps[0][0].sample_rate
        return near_line(bins, line, rate / 2 / (bins - 1), rate)

    def _reference(self, part: _Part, effects: Sequence[Effect]) -> np.ndarray:
        """Return what the reference says in each group (G,) [m]; its errors move the model's distance the other way."""
        m = part.steady
        slope = np.where(self.standing, 0.0, self.slope)[part.groups]

        def distance_at(time):
            return m.range + slope * (time - m.time)

        reading = m.range.copy()
        for effect in effects:
            reading = reading + effect.reference_error(m.time, m.range, distance_at)
        return reading

    def _raised(self, quiet: np.ndarray, added: np.ndarray, line: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Return what the medians of bands show with lines added [dB of 1 LSB^2 per sample], and the noise in each bin.

        Args:
            quiet: noise in bands (2, BANDS) [dB of 1 LSB^2 per sample].
            added: power of lines in each bin (2, B) [LSB^2].
            line: of each station (2,) [Hz].
        """
        bins = added.shape[-1]
        edges = _band_edges(bins)
        power = np.array(self.parts[0].extract.window_power)[:, None]
        floor = np.repeat(10.0 ** (quiet / 10.0) * power, np.diff(edges), axis=1)
        shown, noise = np.where(self._at_line(line, bins), np.nan, floor + added), quiet.copy()
        noticed = np.maximum.reduceat(added / floor, edges[:-1], axis=1) > _NOTICED
        for station, band in zip(*np.nonzero(noticed), strict=True):
            inside = shown[station, edges[band] : edges[band + 1]]
            if np.isfinite(inside).any():
                noise[station, band] = 10.0 * np.log10(np.nanmedian(inside) / power[station, 0])
        return noise, floor

    def _velocity(self, m: Measurements, effects: Sequence[Effect]) -> np.ndarray:
        """Return the slope that the reference shows in each group [m/s] (G,): it sees the crane drive, not sway."""
        driven = m.rows(slice(None))
        for effect in effects:
            if effect.name == 'target_motion':
                effect.prepare(driven)
        return driven.velocity

    def _displacement(self, part: _Part, effects: Sequence[Effect]) -> list[np.ndarray]:
        """Return the movement within each group [m], (n of group,) each."""
        moving = [e for e in effects if 'delay' in e.acts_on and e.of == 'path']
        if not moving:
            return [np.zeros(len(local)) for local in part.local]
        moved = part.all.rows(slice(None))
        for effect in moving:
            effect.prepare(moved)
        way = (moved.paths[0].delay - part.all.paths[0].delay) * SPEED_OF_LIGHT / part.all.refractive_index
        return [way[local] - way[local].mean() for local in part.local]

    def _predicted_noise(self, state: Measurements, line: np.ndarray, amplitude: np.ndarray) -> np.ndarray:
        """Return the noise of each group in bands [dB of 1 LSB^2 per sample] (G, 2, BANDS): floor and skirts."""
        rate = state.stations[0].sweep.sample_rate
        centre = (np.arange(BANDS * 16) + 0.5) * (rate / 2 / (BANDS * 16))
        oscillators = [s.phase_noise for s in state.stations if s.phase_noise is not None]
        result = np.empty((len(line), 2, BANDS))
        for number, station in enumerate(state.stations):
            floor = station.noise_std() ** 2 + QUANTISATION
            at, own = centre[None, :], line[:, number, None]
            offsets = np.stack([np.abs(at - own), np.minimum(at + own, rate - at - own)])
            density = sum((o.single_sideband(offsets) for o in oscillators), np.zeros_like(offsets)).sum(axis=0)
            power = 10.0 ** (amplitude[:, number] / 10.0) / 4.0
            inside = np.abs(at - own) < LINE * (rate / 2 / (self.measured.lines.shape[-1] - 1))
            skirt = np.where(inside, np.nan, density * rate * power[:, None]).reshape(len(line), BANDS, 16)
            with warnings.catch_warnings():
                warnings.simplefilter('ignore', RuntimeWarning)  # a band that a line fills is not compared
                result[:, number] = 10.0 * np.log10(floor[:, None] + np.nanmedian(skirt, axis=2))
        return result

    # --- vectors ---

    def _layout(self) -> Entries:
        """Return what each number of the vector is."""
        parts: list[tuple] = []
        bins = self.measured.lines.shape[-1]
        self._compared_lines = np.stack([~self._at_line(s.line.mean(axis=0), bins) for s in self.sweeps])
        for g in range(len(self.members)):
            for channel in range(4):
                parts += [('ramp', channel, g, k) for k in range(self.measured.ramp.shape[-1])]
            for station in range(2):
                parts += [('lines', station, g, k) for k in range(bins)]
            parts += [('mean', s, g, 0) for s in range(2)]
            parts += [('noise', s, g, b) for s in range(2) for b in range(BANDS)]
            parts += [('beat', -1, g, 0)]
            parts += [('amplitude', s, g, 0) for s in range(2)]
            parts += [('range', -1, g, 0), ('velocity', -1, g, 0)]
            parts += [('movement', -1, g, int(i)) for i in self.members[g]]
        kind, station, group, position = zip(*parts, strict=True)
        return Entries(np.array(kind), np.array(station), np.array(group), np.array(position))

    def _vector(self, values: Groups) -> np.ndarray:
        """Return features less those of the plain model, over their standard deviations."""
        parts = []
        counts = [len(m) for m in self.members]
        starts = np.concatenate([[0], np.cumsum(counts)])
        for g, count in enumerate(counts):
            inside = slice(starts[g], starts[g + 1])
            lines = gaussian(values.lines[g], count) - gaussian(np.ones(1), count)
            differences = [
                ((values.ramp[g] - self.plain.ramp[g]) / self.std.ramp[g]).ravel(),
                np.where(self._compared_lines[g], lines, 0.0).ravel(),
                (values.mean[g] - self.plain.mean[g]) / self.std.mean[g],
                np.nan_to_num((values.noise[g] - self.plain.noise[g]) / self.std.noise[g]).ravel(),
                np.atleast_1d((values.beat[g] - self.plain.beat[g]) / self.std.beat[g]),
                (values.amplitude[g] - self.plain.amplitude[g]) / self.std.amplitude[g],
                np.atleast_1d((values.range[g] - self.plain.range[g]) / self.std.range[g]),
                np.atleast_1d((values.velocity[g] - self.plain.velocity[g]) / self.std.velocity[g]),
                (values.movement[inside] - self.plain.movement[inside]) / self.std.movement[inside],
            ]
            parts += differences
        return np.clip(np.concatenate(parts), -_LARGEST, _LARGEST)

    def template(self, effects: Sequence[Effect]) -> np.ndarray:
        """Return what `effects` add to the model, over the standard deviations of the data; compare with `residual`."""
        distorting = tuple(e for e in effects if e.distorts())
        linear = tuple(e for e in effects if not e.distorts())
        if distorting and linear:  # apart, as a distortion takes many sweeps to simulate
            return self._vector(self.predict(distorting)) + self._vector(self.predict(linear))
        return self._vector(self.predict(effects))


def _band_edges(bins: int) -> np.ndarray:
    """Return the first bin of each band and the end of the last, (BANDS + 1,)."""
    return np.linspace(0, bins, BANDS + 1).astype(int)


def _pooled(values: Sequence[np.ndarray], expected: np.ndarray | None = None) -> np.ndarray:
    """Return standard deviations within groups (G, k), each drawn towards what all groups together say.

    Few sweeps tell their own scatter badly: taken alone it would make large residuals far too likely.

    Args:
        values: of each group (n, k).
        expected: variance of each group (G,) up to a common factor; None where all are alike.
    """
    freedom = np.array([len(v) - 1 for v in values])[:, None]
    own = np.array([v.var(axis=0, ddof=1) for v in values])
    shape = np.ones((len(values), 1)) if expected is None else expected[:, None]
    common = (freedom * own).sum(axis=0) / (freedom * shape).sum(axis=0) * shape
    return np.sqrt((freedom * own + _POOL * common) / (freedom + _POOL))


def _joined(groups: Sequence[Groups]) -> Groups:
    """Return single groups' features as one; movements one after another."""
    stacked = {f.name: np.stack([getattr(g, f.name) for g in groups]) for f in dataclasses.fields(Groups)[:-1]}
    return Groups(**stacked, movement=np.concatenate([g.movement for g in groups]))


def _steady(m: Measurements, local: Sequence[np.ndarray]) -> Measurements:
    """Return one measurement per group, under the group's mean conditions; `local` are the groups' rows of `m`."""
    result = m.rows(np.array([rows[0] for rows in local]))

    def mean(values: np.ndarray) -> np.ndarray:
        return np.array([values[rows].mean() for rows in local])

    for station, source in zip(result.stations, m.stations, strict=True):
        for name in ('received_power', 'temperature'):
            getattr(station, name)[:] = mean(getattr(source, name))
    for path, source in zip(result.paths, m.paths, strict=True):
        path.delay[:] = mean(source.delay)
    for name in ('range', 'time', 'velocity', 'refractive_index'):
        getattr(result, name)[:] = mean(getattr(m, name))
    return result
