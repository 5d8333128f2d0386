"""A recording beside its model: one vector of residuals over their standard deviations, and what effects add to it."""

import dataclasses
import functools
import itertools
import warnings
from collections.abc import Iterator, Sequence

import numpy as np
from scipy.ndimage import uniform_filter1d

from drfmcw_node.estimation import Flag
from drfmcw_node.noise import QUANTISATION
from drfmcw_physics.constants import SPEED_OF_LIGHT
from drfmcw_physics.phase_noise import combination_gain
from drfmcw_physics.settings import ConfigurationError
from drfmcw_sim.effects import Effect
from drfmcw_sim.effects.base import Stage
from drfmcw_sim.signal_model import Measurements, Station, synthesise

from . import coherence
from .dataset import Dataset
from .features import (
    BANDS,
    LINE,
    Extractor,
    SweepFeatures,
    gaussian,
    local_noise,
    mean_power,
    median_of_mean,
    near_line,
    quiet_sweeps,
    ramp_spectrum,
    unevenness,
)
from .groups import Entries, Groups, Part, align, band_edges, joined, pooled, steady
from .known import BEAT_LIMIT, FEWEST, Known

_FREE = 2  # cosine terms that amplitude, phase and frequency of each sweep take out of the ramp
_STEADY = 8  # terms that slow changes of the conditions may move from sweep to sweep
_FLUTTER_MEDIAN = 31  # terms over which the variance around one is taken
_FLUTTER_SPREAD = 1.025  # by which the median of so few widens the spread of what is compared with it
_SMOOTH = 15  # neighbouring cosine terms that share a variance
_FLOOR_LIMIT = 0.02  # what the model of a white floor is trusted to [dB]
_SKIRT_LIMIT = 0.1  # and that of the oscillators' skirts [dB]
_AMPLITUDE_LIMIT = 0.1  # what the link budget is trusted to in each place [dB]
_AMPLITUDE_SHARED = 1.4  # both stations' amplitudes scatter together, which counts their sum twice
_COHERENCE_LIMIT = 0.005  # what the coherence of both lines' noise is trusted to [1]
_MOVEMENT_LIMIT = 1e-5  # what the carrier phase is trusted to [m]
_NEAREST_LINE = 40e3  # to 0 Hz and to the Nyquist frequency: the mirror line is then clear of the ramp [Hz]
_ASTRAY = 1.0  # by which a range differs from those of its group where a line was mistaken [m]
_ASTRAY_SPREADS = 30.0  # or by so many of their median deviations, if that is more
_FADED = 2.0  # by which a level differs from those of its group where something is in the way [dB]
_FADED_SPREADS = 10.0  # or by so many of their median deviations, if that is more
_FADED_SHARE = 0.25  # of a group's sweeps from which on it is no exception
_STANDING = 4.0  # standard deviations of the reference's slope within which a group stands
_NOTICED = 1e-3  # of the noise, below which a line leaves the median of its band alone
_RAISED = 1.5  # of the noise, where the median around a bin counts as raised by lines
_DISTORTED = 8  # sweeps simulated per group where an effect distorts the IF or the crane sways
_BURSTING = 12  # at most, where one comes and goes
_LARGEST = 1e4  # whitened residual beyond which a number says no more
_OF_PATH = ('coherence', 'beat', 'range', 'velocity', 'movement')  # kinds of number that belong to no single station
_SIMULATED_APART = ((False, False), (True, False), (False, True))  # of distorting, of bursts
_KIND = 'U9'  # the longest name


class Comparison:
    """Measured features, their standard deviations, and predictions of the simulator's forward model."""

    def __init__(self, data: Dataset, rows: np.ndarray | None = None) -> None:
        """Extract the features of a recording.

        Args:
            data: the recording, of two stations or of one.
            rows: sweeps to use, None for all.

        Raises:
            ConfigurationError: nowhere enough sweeps under the same conditions to tell their scatter, which two
                stations' oscillators make; few of a station that hears itself count as disturbed by white noise alone,
                but its line must stand clear of 0 Hz.
        """
        self.data = data
        self.heard = tuple(i for i, x in enumerate(data.samples) if x is not None)
        self.receivers = tuple(data.stations[i] for i in self.heard)
        rows = np.arange(len(data)) if rows is None else np.asarray(rows)
        if len(data.stations) == 1:
            rows = rows[(data.lines.flags[0, rows] & Flag.NEAR_DC) == 0]
            if not len(rows):
                raise ConfigurationError(f'{data.path}: no sweep is usable, the line stands too near 0 Hz')
        group = data.group[rows]
        members = [rows[group == g] for g in np.unique(group)]
        self.members = [m for m in members if len(m) >= FEWEST]
        self.scatters = bool(self.members)
        if not self.scatters:
            if len(data.stations) == 2:
                raise ConfigurationError(f'{data.path}: needs at least {FEWEST} sweeps under the same conditions')
            self.members = members
        unsound = 0
        self._extract()
        sound = [self._sound(g) for g in range(len(self.members))]
        if len(data.stations) == 2 and not all(s.all() for s in sound) and any(s.sum() >= FEWEST for s in sound):
            kept = [m[s] for m, s in zip(self.members, sound, strict=True) if s.sum() >= FEWEST]
            unsound = sum(map(len, self.members)) - sum(map(len, kept))
            self.members = kept
            self._extract()
        self.known = Known(data, self.heard, self.members, self.scatters, unsound)
        self.time, self.channels = self.sweeps[0].time, self.parts[0].extract.channels
        slope, slope_std = data.velocity, data.velocity_std
        self.slope = np.array([np.nanmean(slope[m]) if np.isfinite(slope[m]).any() else 0.0 for m in self.members])
        known = [np.isfinite(slope_std[m]).any() for m in self.members]
        self.slope_std = np.array(
            [np.nanmean(slope_std[m]) if k else np.inf for m, k in zip(self.members, known, strict=True)]
        )
        self.standing = np.abs(self.slope) < _STANDING * np.where(known, self.slope_std, np.inf)
        self.measured, self.std = self._measure()
        self._plain_power: dict[int, np.ndarray] = {}
        # what noise makes without any effect, by the first group of a part
        self._undistorted: dict[int, np.ndarray] = {}
        self._steady: dict[int, tuple[np.ndarray, np.ndarray]] = {}
        self.plain = self.predict(())
        self.std = dataclasses.replace(self.std, noise=np.hypot(self.std.noise, self._noise_limit()))
        self.entries = self._layout()
        self.residual = self._vector(self.measured)

    def _extract(self) -> None:
        """Take the features of all members' sweeps."""
        data = self.data
        self.parts = [self._part(setting) for setting in np.unique(data.setting[np.concatenate(self.members)])]
        self.sweeps: list[SweepFeatures] = [None] * len(self.members)
        self._shares: list[np.ndarray] = [None] * len(self.members)  # of sweeps in the coherence (n, OFFSETS)
        for part in self.parts:
            for g in part.groups:
                samples = tuple(data.samples[i][self.members[g]] for i in self.heard)
                scale = float(np.median(data.full_scale[self.heard[0], self.members[g]]))
                self.sweeps[g] = part.extract(samples, scale, data.refractive_index[self.members[g]])
                self._shares[g] = part.extract.shared_noise(samples, self.sweeps[g])

    def _sound(self, group: int) -> np.ndarray:
        """Return which sweeps of a group have their lines where they should be, clear of 0 Hz and of Nyquist (n,).

        Neither are few of them far weaker than the others: something stood in the way.
        """
        sweeps, rate = self.sweeps[group], self.data.sweeps[0][0].sample_rate
        clear = np.all((sweeps.line > _NEAREST_LINE) & (sweeps.line < rate / 2 - _NEAREST_LINE), axis=1)
        error = sweeps.range - self.data.distance[self.members[group]]
        error = np.abs(error - np.median(error))
        clear &= error < max(_ASTRAY, _ASTRAY_SPREADS * float(np.median(error)))
        apart = np.abs(sweeps.amplitude - np.median(sweeps.amplitude, axis=0))
        faded = np.any(apart > np.maximum(_FADED, _FADED_SPREADS * np.median(apart, axis=0)), axis=1)
        return clear & ~(faded & (np.mean(faded) < _FADED_SHARE))

    def _part(self, setting: int) -> Part:
        """Return the groups of one setting and their nominal conditions."""
        data = self.data
        groups = np.array([g for g, m in enumerate(self.members) if data.setting[m[0]] == setting])
        counts = [len(self.members[g]) for g in groups]
        starts = np.concatenate([[0], np.cumsum(counts)])
        local = [np.arange(a, b) for a, b in itertools.pairwise(starts)]
        nominal = data.nominal(np.concatenate([self.members[g] for g in groups]))
        extract = Extractor(data.sweeps[setting], data.calibration, self.heard, data.iq)
        return Part(groups, local, nominal, steady(nominal, local), extract)

    # --- the recording ---

    def _measure(self) -> tuple[Groups, Groups]:
        """Return the measured features of all groups and their standard deviations."""
        errors_of_range = [s.range - self.data.distance[m] for s, m in zip(self.sweeps, self.members, strict=True)]
        range_std, beat_std, amplitude_std = self._scatter(errors_of_range)
        harmonic_std, coherence_std = self._harmonic_scatter(), self._coherence_scatter()
        movement_told = any(part.extract.way_per_phase for part in self.parts)
        noise_told, range_limit = self.known.noise(), self.known.range_limit()
        self._quiet: list[np.ndarray] = []  # sweeps without a burst of each group (S,)
        values: list[Groups] = []
        errors: list[Groups] = []
        for g, (rows, sweeps, standing) in enumerate(zip(self.members, self.sweeps, self.standing, strict=True)):
            n = len(rows)
            root = np.sqrt(n)
            ramp = ramp_spectrum(sweeps.ramp)
            power, quiet = mean_power(sweeps.power, quiet_sweeps(sweeps.quiet))
            self._quiet.append(quiet)
            around = local_noise(power) / median_of_mean(quiet)[:, None]
            noise, noise_std = self._bands(power, sweeps.line.mean(axis=0), quiet)
            noise_std[~noise_told] = np.inf
            ramp_variance, mean_variance = self._variances(sweeps, ramp, noise)
            flutter, steady_variance = self._flutter(ramp)
            ramp_std = np.full(ramp.shape[1:], np.inf)
            ramp_std[:, _FREE:] = np.sqrt(ramp_variance / n)
            burst, burst_std = unevenness(sweeps.quiet) if self.scatters else (np.zeros((len(self.heard), 3)), np.inf)
            error = errors_of_range[g]
            movement, movement_std = self._movement(sweeps, standing and movement_told)
            values.append(
                Groups(
                    ramp.mean(axis=0),
                    flutter,
                    power / around,
                    sweeps.mean.mean(axis=0),
                    sweeps.harmonic.mean(axis=0),
                    burst,
                    noise,
                    self._shares[g].mean(axis=0),
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
                    steady_variance,
                    around,
                    np.maximum(np.sqrt(mean_variance), 0.01) / root,
                    harmonic_std[g] / root,
                    burst_std,
                    noise_std,
                    coherence_std[g] / root,
                    np.hypot(beat_std[g] / root, BEAT_LIMIT),
                    np.hypot(amplitude_std[g] / root, _AMPLITUDE_LIMIT),
                    np.hypot(max(range_std[g], 1e-5) / root, range_limit[g]),
                    self.slope_std[g],
                    movement_std,
                )
            )
        return joined(values), joined(errors)

    def _scatter(self, errors_of_range: list[np.ndarray]) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Return by what sweeps scatter: range (G,), beat (G,), amplitudes (G, S); inf where nothing tells it."""
        told, groups = self.known.range(), len(self.members)
        expected = np.array(
            [
                np.mean(s.range_std**2 + np.nan_to_num(self.data.reference_std[m]) ** 2)
                for s, m in zip(self.sweeps, self.members, strict=True)
            ]
        )
        range_std, beat_std = np.full(groups, np.inf), np.full(groups, np.inf)
        amplitude_std = np.full((groups, len(self.heard)), np.inf)
        if not self.scatters:
            range_std[told] = np.sqrt(expected[told])
            return range_std, beat_std, amplitude_std
        if told.any():
            errors = [e[:, None] for e, t in zip(errors_of_range, told, strict=True) if t]
            range_std[told] = pooled(errors, expected[told])[:, 0]
        if len(self.heard) == 2:
            beat_std = pooled([s.beat[:, None] for s in self.sweeps])[:, 0]
        shared = _AMPLITUDE_SHARED if len(self.heard) == 2 else 1.0
        amplitude_std = np.where(self.known.power(), shared * pooled([s.amplitude for s in self.sweeps]), np.inf)
        return range_std, beat_std, amplitude_std

    def _harmonic_scatter(self) -> np.ndarray:
        """Return by what harmonics scatter from sweep to sweep (G, S, 2 H), alike in both parts of each."""
        if not self.scatters:
            return np.full((len(self.members), *self.sweeps[0].harmonic.shape[1:]), np.inf)
        variance = np.array([s.harmonic.var(axis=0, ddof=1) for s in self.sweeps])
        both = variance.reshape(*variance.shape[:2], 2, -1).mean(axis=2)
        return np.sqrt(np.nan_to_num(np.tile(both, 2), nan=np.inf))

    def _coherence_scatter(self) -> np.ndarray:
        """Return by what shares in the coherence scatter from sweep to sweep (G, OFFSETS); inf where not compared."""
        if not (self.scatters and len(self.heard) == 2 and self.known.noise().all()):
            return np.full((len(self.members), coherence.OFFSETS), np.inf)
        scatter = pooled(self._shares)
        present = np.array([np.any(s != 0.0, axis=0) for s in self._shares])
        limit = _COHERENCE_LIMIT * np.sqrt([len(s) for s in self._shares])[:, None]
        return np.where(present, np.hypot(scatter, limit), np.inf)

    def _variances(self, sweeps: SweepFeatures, ramp: np.ndarray, noise: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Return variances of one sweep of a group: of the ramp's terms but the free ones, and of the means (S, Q).

        Args:
            sweeps: their features.
            ramp: cosine series of the same (n, 2 S, K).
            noise: in bands (S, BANDS) [dB of 1 LSB^2 per sample].
        """
        if self.scatters:
            variance = ramp[..., _FREE:].var(axis=0, ddof=1)
            return uniform_filter1d(variance, _SMOOTH, mode='nearest', axis=-1), sweeps.mean.var(axis=0, ddof=1)
        white = 10.0 ** (np.nanmedian(noise, axis=1) / 10.0)
        variance, mean_variance = self.parts[0].extract.white_noise(sweeps, white)
        return variance[:, None], mean_variance

    def _flutter(self, ramp: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Return variances over what noise makes of them, and what noise makes of them, (2 S, K) each.

        Args:
            ramp: cosine series of a group's sweeps (n, 2 S, K).
        """
        if not self.scatters:
            return np.ones(ramp.shape[1:]), np.ones(ramp.shape[1:])
        variance = ramp.var(axis=0, ddof=1)
        around = local_noise(variance, _FLUTTER_MEDIAN) / median_of_mean((len(ramp) - 1) / 2)
        return variance / around, around

    def _floor(self, station: Station, passed: np.ndarray) -> np.ndarray:
        """Return the variance of a sample without skirts (n, k) [LSB^2], of both of its parts with iq.

        Args:
            station: n sweeps of it.
            passed: share of the noise before the ADC that filters leave (k,).
        """
        before = station.noise_std()[:, None] ** 2 * passed
        return (before + QUANTISATION) * (2.0 if self.data.iq else 1.0)

    def _noise_limit(self) -> np.ndarray:
        """Return what the model of the noise in bands is trusted to (G, S, BANDS) [dB]: less where a skirt rules."""
        limit = np.empty(self.plain.noise.shape)
        for part in self.parts:
            floor = np.stack([self._floor(part.steady.stations[i], np.ones(1)) for i in self.heard], axis=1)
            share = 1.0 - floor / 10.0 ** (self.plain.noise[part.groups] / 10.0)
            limit[part.groups] = _FLOOR_LIMIT + _SKIRT_LIMIT * np.clip(share, 0.0, 1.0)
        return limit

    def _bands(self, power: np.ndarray, line: np.ndarray, count: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Return the noise of each station in bands [dB of 1 LSB^2 per sample] and its deviation, (S, BANDS) each.

        Args:
            power: mean spectra (S, B) [LSB^2].
            line: of each station (S,) [Hz].
            count: of the sweeps in each mean (S,).
        """
        bins = power.shape[-1]
        masked = self._at_line(line, bins)
        noise, std = (np.full((len(power), BANDS), value) for value in (np.nan, np.inf))
        edges = band_edges(bins)
        extractor = self.parts[0].extract
        for station in range(len(power)):
            for band in range(BANDS):
                inside = power[station, edges[band] : edges[band + 1]]
                inside = inside[~masked[station, edges[band] : edges[band + 1]]]
                if len(inside) < 16:
                    continue
                median = np.median(inside) / median_of_mean(count[station])
                noise[station, band] = 10.0 * np.log10(median / extractor.window_power[station])
                # neighbouring bins of a Hann window share half of their noise; a median has 1.25 times the mean's
                std[station, band] = 4.34 * 1.25 * np.sqrt(1.9 / (len(inside) * count[station]))
        return noise, std

    def _movement(self, sweeps: SweepFeatures, standing: bool) -> tuple[np.ndarray, np.ndarray]:
        """Return the displacement within a group by the carrier phase [m] (n,), and its deviation: inf on a drive."""
        wave = self.parts[0].extract.way_per_phase
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
            state = self._acted(part, effects)
            features = self._simulated(part, [e for e in effects if not e.bursts()])
            reference = self._reference(part, effects)
            displacement = self._displacement(part, effects)
            quiet, shared = self._predicted_noise(part, state, effects, features.line)
            velocity = self._velocity(part.steady, effects)
            distorting = any(e.distorts() for e in effects)
            changed = self._changed_noise(part, effects) if distorting else np.zeros_like(quiet)
            burst = np.zeros((len(part.groups), len(self.heard), 3))
            if any(e.bursts() for e in effects):
                burst, louder = self._bursts(part, effects)
                quiet = quiet + louder
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
                    raised[~np.any(added > floor, axis=1)] = False
                    around[raised] = (floor / self.std.lines[g])[raised]
                found[g] = Groups(
                    ramp_spectrum(features.ramp[row]),
                    np.ones(self.measured.flutter.shape[1:]),
                    around + added / self.std.lines[g],
                    features.mean[row],
                    features.harmonic[row],
                    burst[row],
                    noise,
                    shared[row],
                    features.beat[row],
                    features.amplitude[row],
                    features.range[row] - reference[row],
                    velocity[row],
                    displacement[row],
                )
        return joined(found)

    @staticmethod
    def _acted(part: Part, effects: Sequence[Effect]) -> Measurements:
        """Return the groups' steady conditions after effects."""
        state = part.steady.rows(slice(None))
        for effect in sorted(effects, key=lambda e: e.stage):
            effect.prepare(state)
        return state

    def _simulated(self, part: Part, effects: Sequence[Effect]) -> SweepFeatures:
        """Return the features of one noise-free sweep pair per group.

        Mean of sweeps whose phases lie evenly over half a turn: what mirror lines and harmonics leak cancels in them,
        as it does in a recording's sweeps of random phase.
        """
        distorting = any(effect.distorts() for effect in effects)
        swaying = any(effect.name == 'sway' for effect in effects)
        copies = _DISTORTED if distorting or swaying else 2
        each, moved = self._copies(part, effects, copies, swaying)
        features = _mean(each, copies)
        if np.any(moved):
            way = moved * SPEED_OF_LIGHT / part.steady.refractive_index
            features = dataclasses.replace(features, range=features.range - way)
        if distorting:
            jittered = self._distorted(part, effects, False)
            features = dataclasses.replace(features, power=jittered.power, harmonic=jittered.harmonic)
        return features

    def _copies(
        self, part: Part, effects: Sequence[Effect], copies: int, swaying: bool = False
    ) -> tuple[SweepFeatures, np.ndarray]:
        """Return features of sweeps whose phases lie evenly over half a turn, and the delay that `align` added (G,)."""
        count = len(part.groups)
        rows = part.steady.rows(np.tile(np.arange(count), copies))
        rows.initial_phase[0] += np.repeat(np.arange(copies) / (2.0 * copies), count)
        if swaying:  # a group's mean is that over its time, in which a crane may swing far
            rows.time += np.stack([self._times(g, copies) for g in part.groups], axis=1).ravel()
        moved = align(part, rows, copies, self.sweeps, self._acted(part, effects))
        return self._features(part, rows, effects), moved

    def changing(self, effects: Sequence[Effect]) -> np.ndarray:
        """Return by how much the ramp changes with the phase of each sweep, over the noise of one sweep (G, 2 S, K).

        What a spur or a mirror line brings has a phase of its own in every sweep.
        """
        result = np.zeros(self.measured.flutter.shape)
        for part in self.parts:
            ramp = ramp_spectrum(self._copies(part, [e for e in effects if not e.bursts()], 2)[0].ramp)
            result[part.groups] = ramp.reshape(2, -1, *ramp.shape[1:]).var(axis=0, ddof=1)
        return result / self.std.flutter

    def _features(
        self, part: Part, rows: Measurements, effects: Sequence[Effect], noise: bool = False
    ) -> SweepFeatures:
        """Return features of simulated sweeps."""
        samples = synthesise(rows, 0, effects, noise=noise, quantised=False)
        heard = tuple(samples[i].reshape(len(rows), -1) for i in self.heard)
        return part.extract(heard, rows.stations[self.heard[0]].full_scale, rows.refractive_index)

    def _jittered(self, part: Part, effects: Sequence[Effect], noise: bool, copies: int) -> SweepFeatures:
        """Return features of sweeps with start delays and amplitudes of measured ones, (copies x groups, ...).

        Harmonics multiply the jitter.
        """
        rows = part.steady.rows(np.tile(np.arange(len(part.groups)), copies))
        rows.sweep_id = np.arange(len(rows))
        delays = np.stack([self._start_delays(g, copies) for g in part.groups], axis=1)
        rows.start_delay += delays.ravel()
        amplitudes = np.stack([self._amplitudes(g, copies) for g in part.groups], axis=1)
        for number, heard in enumerate(self.heard):
            rows.stations[heard].received_power += amplitudes[..., number].ravel()
        align(part, rows, copies, self.sweeps, self._acted(part, effects))
        return self._features(part, rows, effects, noise)

    def _distorted(self, part: Part, effects: Sequence[Effect], noise: bool) -> SweepFeatures:
        """Return mean features of sweeps with the start delays and amplitudes of measured ones."""
        return _mean(self._jittered(part, effects, noise, _DISTORTED), _DISTORTED)

    def _changed_noise(self, part: Part, effects: Sequence[Effect]) -> np.ndarray:
        """Return by how much distortion changes the noise in bands (G, S, BANDS) [dB]: a limiter holds noise down."""
        first = int(part.groups[0])
        if first not in self._undistorted:
            self._undistorted[first] = self._noisy_bands(part, ())
        return np.nan_to_num(self._noisy_bands(part, effects) - self._undistorted[first])

    def _noisy_bands(self, part: Part, effects: Sequence[Effect]) -> np.ndarray:
        """Return the noise in bands of noisy sweeps (G, S, BANDS) [dB of 1 LSB^2 per sample]."""
        features = self._distorted(part, effects, True)
        counts = np.full(len(self.heard), _DISTORTED)
        return np.array(
            [self._bands(p, line, counts)[0] for p, line in zip(features.power, features.line, strict=True)]
        )

    def _times(self, group: int, count: int) -> np.ndarray:
        """Return times spread over a group's sweeps, from their mean [s] (count,)."""
        time = self.data.time[self.members[group]]
        return np.interp((np.arange(count) + 0.5) / count * len(time) - 0.5, np.arange(len(time)), time) - time.mean()

    def _amplitudes(self, group: int, count: int) -> np.ndarray:
        """Return deviations of the amplitudes from the group's mean, of `count` of its sweeps (count, S) [dB]."""
        return _spread(self.sweeps[group].amplitude, count)

    def _bursts(self, part: Part, effects: Sequence[Effect]) -> tuple[np.ndarray, np.ndarray]:
        """Return what bursts do: unevenness (G, S, 3), and by how much they raise noise in bands (G, S, BANDS) [dB].

        Simulated among noise, with the same noise as without them.
        """
        first = int(part.groups[0])
        if first not in self._steady:
            self._steady[first] = self._among_noise(part, ())
        (uneven, bands), (even, plain) = self._among_noise(part, effects), self._steady[first]
        # bursts know no distance, and all groups together hold enough of them
        return np.tile((uneven - even).mean(axis=0), (len(uneven), 1, 1)), np.nan_to_num(bands - plain)

    def _among_noise(self, part: Part, effects: Sequence[Effect]) -> tuple[np.ndarray, np.ndarray]:
        """Return unevenness (G, S, 3) and noise in bands between bursts (G, S, BANDS) [dB] of noisy sweeps."""
        copies, count = min(max(map(len, part.local)), _BURSTING), len(part.groups)
        features = self._jittered(part, effects, True, copies)
        quiet, power = (x.reshape(copies, count, *x.shape[1:]).swapaxes(0, 1) for x in (features.quiet, features.power))
        line = features.line.reshape(copies, count, -1).mean(axis=0)
        spectra = [mean_power(p, quiet_sweeps(q)) for p, q in zip(power, quiet, strict=True)]
        bands = [self._bands(p, at, n)[0] for (p, n), at in zip(spectra, line, strict=True)]
        return np.array([unevenness(q)[0] for q in quiet]), np.array(bands)

    def _start_delays(self, group: int, count: int) -> np.ndarray:
        """Return deviations of T_off from the group's mean, of `count` of its sweeps [s]."""
        return _spread(self.sweeps[group].beat, count) / self.parts[0].extract.beat_per_start_delay

    def _at_line(self, line: np.ndarray, bins: int) -> np.ndarray:
        """Return which bins (S, B) are left to the features of the lines themselves; `line` (S,) [Hz]."""
        rate = self.data.sweeps[0][0].sample_rate
        return near_line(bins, line, rate / 2 / (bins - 1), rate)

    def _reference(self, part: Part, effects: Sequence[Effect]) -> np.ndarray:
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
            quiet: noise in bands (S, BANDS) [dB of 1 LSB^2 per sample].
            added: power of lines in each bin (S, B) [LSB^2].
            line: of each station (S,) [Hz].
        """
        bins = added.shape[-1]
        edges = band_edges(bins)
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

    def _displacement(self, part: Part, effects: Sequence[Effect]) -> list[np.ndarray]:
        """Return the movement within each group [m], (n of group,) each."""
        # geometry follows the distance, of which each sweep has a reading with noise but a standing crane has one
        moving = [e for e in effects if 'delay' in e.acts_on and e.of == 'path' and e.stage != Stage.GEOMETRY]
        if not moving:
            return [np.zeros(len(local)) for local in part.local]
        moved = part.all.rows(slice(None))
        for effect in moving:
            effect.prepare(moved)
        way = (moved.paths[0].delay - part.all.paths[0].delay) * SPEED_OF_LIGHT / part.all.refractive_index
        return [way[local] - way[local].mean() for local in part.local]

    def _response(
        self, station: Station, state: Measurements, effects: Sequence[Effect], frequency: np.ndarray
    ) -> np.ndarray:
        """Return by how much the filters among `effects` pass frequencies (...) of a station's IF, complex."""
        filters = [e for e in effects if e.stage == Stage.FILTER and e.applies_to(station.name)]
        if not filters:
            return np.ones(frequency.shape)
        one = state.rows(slice(0, 1))
        count = station.sweep.sample_count
        impulse = np.zeros((1, count, 2) if self.data.iq else (1, count), np.float32)
        impulse[0, count // 2] = 1.0  # a cut at the Nyquist frequency rings both ways
        for effect in filters:
            effect.receive(impulse, next(s for s in one.stations if s.name == station.name), one, list)
        spectrum = np.fft.rfft(impulse[..., 0] if self.data.iq else impulse, axis=1)[0]
        spectrum *= np.exp(2j * np.pi * (count // 2) / count * np.arange(len(spectrum)))  # time counts from the impulse
        return np.interp(frequency, np.arange(len(spectrum)) * station.sweep.sample_rate / count, spectrum)

    def _predicted_noise(
        self, part: Part, state: Measurements, effects: Sequence[Effect], line: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray]:
        """Return the noise of each group in bands [dB of 1 LSB^2 per sample] (G, S, BANDS), and what both share.

        Skirts go with the power that a line has, whatever made it.
        """
        rate = state.stations[0].sweep.sample_rate
        centre = (np.arange(BANDS * 16) + 0.5) * (rate / 2 / (BANDS * 16))
        oscillators = [s.phase_noise for s in state.stations if s.phase_noise is not None]
        amplitude = np.array([self.sweeps[g].amplitude.mean(axis=0) for g in part.groups])
        powers = 10.0 ** (amplitude / 10.0) * (1.0 if self.data.iq else 0.25)  # at each frequency of a line
        result = np.empty((len(line), len(self.heard), BANDS))
        for number, heard in enumerate(self.heard):
            station = state.stations[heard]
            at, own = centre[None, :], line[:, number, None]
            offsets = np.stack([np.abs(at - own), np.minimum(at + own, rate - at - own)])
            if self.data.iq:  # all of the line at one frequency, no mirror line
                offsets = np.minimum(offsets[:1], rate - offsets[:1])
            density = sum((o.single_sideband(offsets) for o in oscillators), np.zeros_like(offsets))
            if len(state.stations) == 1:  # the oscillator meets itself, a delay later
                density = density * combination_gain(offsets, state.paths[0].delay[:, None])
            density = density.sum(axis=0)
            inside = np.abs(at - own) < LINE * (rate / 2 / (self.measured.lines.shape[-1] - 1))
            passed = np.abs(self._response(station, state, effects, centre)) ** 2
            # the line's own power has passed the filters already
            share = passed / np.abs(self._response(station, state, effects, line[:, number])[:, None]) ** 2
            skirts = share * density * rate * powers[:, number, None]
            total = self._floor(station, passed) + np.where(inside, np.nan, skirts)
            bands = total.reshape(len(line), BANDS, 16)
            with warnings.catch_warnings():
                warnings.simplefilter('ignore', RuntimeWarning)  # a band that a line fills is not compared
                result[:, number] = 10.0 * np.log10(np.nanmedian(bands, axis=2))
        return result, self._shared_noise(part, state, effects, powers)

    def _shared_noise(
        self, part: Part, state: Measurements, effects: Sequence[Effect], powers: np.ndarray
    ) -> np.ndarray:
        """Return the coherence of both lines' phase noise in each group (G, OFFSETS); zero where it is not compared.

        Args:
            part: groups of one setting.
            state: their conditions after effects.
            effects: of which filters pass sidebands by their frequency.
            powers: of the lines, at positive frequency (G, S) [LSB^2].
        """
        result = np.zeros((len(part.groups), coherence.OFFSETS))
        if not np.isfinite(self.std.coherence[part.groups]).any():
            return result
        rate = state.stations[0].sweep.sample_rate
        oscillators = [s.phase_noise for s in state.stations]
        for row, g in enumerate(part.groups):
            line = self.sweeps[g].line.mean(axis=0)
            used = coherence.sidebands(line, state.stations[0].sweep)
            floors, responses = [], []
            for station, at, power in zip(state.stations, line, powers[row], strict=True):
                sides = np.clip(at + np.stack([used.offset, -used.offset]), 0.0, rate / 2)
                response = self._response(station, state, effects, sides)
                one = state.rows(slice(row, row + 1))
                station = next(s for s in one.stations if s.name == station.name)
                own = self._response(station, state, effects, np.array([at]))
                floor = self._floor(station, np.abs(response.reshape(-1)) ** 2).reshape(sides.shape)
                # what the mirror lines' skirts bring there has a phase of its own
                mirrors = sum(o.single_sideband(m) for o in oscillators for m in (at + sides, rate - at - sides))
                responses.append(response / own)
                floors.append(floor / (rate * power) + mirrors * np.abs(responses[-1]) ** 2)
            clocks = [float(s.sample_clock[row]) for s in state.stations]
            middle = 0.5 * state.stations[0].sweep.record_duration
            result[row] = coherence.predicted(
                used,
                np.array([o.single_sideband(used.offset) for o in oscillators]),
                np.array(floors),
                np.array(responses),
                float(state.paths[0].delay[row]),
                middle * (1.0 / clocks[0] - 1.0 / clocks[1]),
            )
        return result

    # --- vectors ---

    def _blocks(self, values: Groups, g: int) -> Iterator[tuple[str, np.ndarray]]:
        """Yield what a group holds beyond the plain model, over its deviations: (kind, (stations, positions)).

        One row stands for the path, else there is one of each station with samples, or of each of the ramp's channels.
        """
        count, start = len(self.members[g]), int(self._starts[g])
        inside = slice(start, start + count)

        def over(name: str) -> np.ndarray:
            return (getattr(values, name)[g] - getattr(self.plain, name)[g]) / getattr(self.std, name)[g]

        yield 'ramp', over('ramp')
        freedom = max((count - 1) / 2, 0.5)
        fluttering = (gaussian(values.flutter[g], freedom) - gaussian(np.ones(1), freedom)) / _FLUTTER_SPREAD
        compared = (np.arange(fluttering.shape[1]) >= _STEADY) & self.scatters & self.standing[g]
        yield 'flutter', np.where(compared, fluttering, 0.0)
        quiet = self._quiet[g][:, None]
        lines = gaussian(values.lines[g], quiet) - gaussian(np.ones(1), quiet)
        yield 'lines', np.where(self._compared_lines[g], lines, 0.0)
        yield 'mean', over('mean')
        yield 'harmonic', np.nan_to_num(over('harmonic'))
        yield 'burst', over('burst')
        yield 'noise', np.nan_to_num(over('noise'))
        yield 'coherence', over('coherence')[None]
        yield 'beat', np.reshape(over('beat'), (1, 1))
        yield 'amplitude', over('amplitude')[:, None]
        yield 'range', np.reshape(over('range'), (1, 1))
        yield 'velocity', np.reshape(over('velocity'), (1, 1))
        moved = (values.movement[inside] - self.plain.movement[inside]) / self.std.movement[inside]
        yield 'movement', moved[None]

    def _layout(self) -> Entries:
        """Return what each number of the vector is."""
        parts: list[tuple[np.ndarray, ...]] = []
        bins = self.measured.lines.shape[-1]
        self._compared_lines = np.stack([~self._at_line(s.line.mean(axis=0), bins) for s in self.sweeps])
        self._starts = np.cumsum([0, *map(len, self.members)])
        for g, members in enumerate(self.members):
            for kind, block in self._blocks(self.measured, g):
                rows, columns = block.shape
                station = np.repeat([-1] if kind in _OF_PATH else np.arange(rows), columns)
                position = np.tile(members if kind == 'movement' else np.arange(columns), rows)
                parts.append((np.full(block.size, kind, _KIND), station, np.full(block.size, g), position))
        return Entries(*map(np.concatenate, zip(*parts, strict=True)))

    def _vector(self, values: Groups) -> np.ndarray:
        """Return features less those of the plain model, over their standard deviations."""
        parts = [block.ravel() for g in range(len(self.members)) for _, block in self._blocks(values, g)]
        return np.clip(np.concatenate(parts), -_LARGEST, _LARGEST)

    def template(self, effects: Sequence[Effect]) -> np.ndarray:
        """Return what `effects` add to the model, over the standard deviations of the data; compare with `residual`."""
        # apart, as a distortion or a burst takes many sweeps to simulate
        apart = [tuple(e for e in effects if (e.distorts(), e.bursts()) == kind) for kind in _SIMULATED_APART]
        return sum(self._vector(self.predict(part)) for part in apart if part) if effects else self._vector(self.plain)


def _spread(values: np.ndarray, count: int) -> np.ndarray:
    """Return the values of `count` sweeps spread over a group's (n, ...), less the mean of all."""
    return values[np.linspace(0, len(values) - 1, count).astype(int)] - values.mean(axis=0)


def _mean(features: SweepFeatures, copies: int) -> SweepFeatures:
    """Return the means of copies of sweeps, of each group."""
    count = len(features.carrier) // copies
    means = {
        f.name: getattr(features, f.name).reshape(copies, count, *getattr(features, f.name).shape[1:]).mean(axis=0)
        for f in dataclasses.fields(SweepFeatures)
        if f.name not in ('time', 'carrier')
    }
    return dataclasses.replace(features, **means, carrier=features.carrier[:count])
