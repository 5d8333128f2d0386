"""What the simulator's forward model makes of a recording's groups, with effects or without."""

import dataclasses
import functools
from collections.abc import Iterator, Mapping, Sequence

import numpy as np

from drfmcw_fusion.tracking import doppler_range_rate
from drfmcw_physics.constants import SPEED_OF_LIGHT
from drfmcw_sim.effects import ActsOn, Effect, Motion, Of, Stage
from drfmcw_sim.measurements import Measurements

from ..features.extractor import SweepFeatures, quiet_sweeps, ramp_spectrum
from ..features.spectra import local_noise, mean_power
from ..features.surges import unevenness
from .groups import Part, acted, move, shows_place
from .limits import SIMULATION
from .noise_model import NoiseModel
from .recorded_sweeps import RecordedSweeps
from .simulated_sweeps import SimulatedSweeps


@dataclasses.dataclass(frozen=True)
class Distortion:
    """By how much distortion changes what noisy sweeps show."""

    noise: np.ndarray  # in bands (G, S, N) [dB]
    harmonic: np.ndarray  # (G, S, 2 H)
    piled: np.ndarray  # (G, S)


@dataclasses.dataclass(frozen=True)
class Bursts:
    """By how much bursts change what noisy sweeps show."""

    uneven: np.ndarray  # (S, K), of all groups together
    noise: np.ndarray  # in bands (G, S, N) [dB]


class Expected:
    """What the model with some effects makes of the G groups of one setting; each computed when first asked for.

    Attributes:
        model: that predicts it.
        recorded: the groups as recorded.
        part: the same where the model has them.
        effects: that act.
        reference: what the reference says in each group (G,) [m].
        distorting: an effect distorts the IF.
        bursting: an effect comes and goes.
    """

    def __init__(
        self,
        model: 'Predictor',
        recorded: Part,
        effects: tuple[Effect, ...],
        displaced: bool = False,
        outcome: int | None = None,
    ) -> None:
        """Put the groups where the effects have them; `displaced` by a standard deviation of the reference's mean.

        With an `outcome`, random phases scatter in that way by a standard deviation, see `SimulatedSweeps.fluttering`.
        """
        self.model, self.recorded, self.effects, self._displaced = model, recorded, effects, displaced
        self._outcome = outcome
        self.part, self.reference = model.placed(recorded, effects, displaced)
        self.distorting = any(e.distorts for e in effects)
        self.bursting = any(e.bursts for e in effects)

    @functools.cached_property
    def undistorted(self) -> 'Expected':
        """The same without the effects that distort the IF."""
        effects = tuple(e for e in self.effects if not e.distorts)
        return Expected(self.model, self.recorded, effects, self._displaced, self._outcome)

    @property
    def std(self) -> Mapping[str, np.ndarray]:
        """Standard deviations of the measured numbers of all groups, by kind."""
        return self.model.std

    @functools.cached_property
    def plain(self) -> 'Expected':
        """The same without effects."""
        return self.model.plain(self.recorded) if self.effects else self

    @functools.cached_property
    def features(self) -> SweepFeatures:
        """Features of one noise-free sweep pair per group."""
        return self.model.simulated.mean(self.part, [e for e in self.effects if not e.bursts])

    @functools.cached_property
    def fluttering(self) -> np.ndarray | None:
        """Variance of the ramp's terms over the phases of effects that fluctuate (G, 2 S, K), None without any."""
        return self._of_phases[1] if any(e.fluctuates for e in self.effects) else None

    @functools.cached_property
    def ramp(self) -> np.ndarray:
        """Mean of the ramp's terms (G, 2 S, K)."""
        mean = ramp_spectrum(self.features.ramp)
        return mean if self._outcome is None else mean + self._of_phases[0]

    @functools.cached_property
    def _of_phases(self) -> tuple[np.ndarray | float, np.ndarray]:
        """What random phases add to the mean of the ramp's terms, and their variance; see `outcome`."""
        effects = [e for e in self.effects if not e.bursts]
        variance, *scatter = self.model.simulated.fluttering(self.part, effects)
        if self._outcome is None:
            return 0.0, variance
        of_variance, number = divmod(self._outcome, len(scatter[0]))
        added = scatter[of_variance][number]
        return (0.0, variance + added) if of_variance else (added, variance)

    def samples(self, noise: bool = False) -> tuple[np.ndarray, ...]:
        """Return one simulated sweep per group, of each station with samples (G, N), with iq (G, 2 N) [LSB]."""
        return self.model.simulated.samples(self.part, self.effects, noise)

    @functools.cached_property
    def _state(self) -> Measurements:
        """Conditions of the groups after effects."""
        return acted(self.part, self.effects)

    @functools.cached_property
    def noise(self) -> tuple[np.ndarray, np.ndarray]:
        """Noise in bands (G, S, N) [dB of 1 LSB^2 per sample], and the coherence of both lines (G, C)."""
        return self.model.noise.predicted(self.part, self._state, self.effects, self.features.line)

    @functools.cached_property
    def amplitude(self) -> np.ndarray:
        """Power that each line shows (G, S) [dB of 1 LSB]: phase noise takes a part, additive noise adds some."""
        noise = self.model.noise
        level = self.features.amplitude - noise.loss(self.part, self._state)
        return level + noise.rise(self.part, self._state, self.effects, level, self.features.line)

    @functools.cached_property
    def added(self) -> np.ndarray:
        """Power that effects add to each bin beside the lines (G, S, B) [LSB^2]."""
        added = np.maximum(self.features.power - self.plain.features.power, 0.0).astype(float)
        power, smooth = self.random
        added += np.maximum(power - smooth, 0.0)
        added[self.model.recorded.bands.at_line(self.features.line, added.shape[-1])] = 0.0
        return added

    @functools.cached_property
    def random(self) -> tuple[np.ndarray, np.ndarray]:
        """Power of random phase that effects add to each bin (G, S, B), and its smooth course over them [LSB^2]."""
        power = self.model.random_power(self.part, self.effects, self.features.power.shape[-1])
        return power, local_noise(power) if np.any(power) else power

    @functools.cached_property
    def raised(self) -> tuple[np.ndarray, np.ndarray]:
        """Noise in bands as further lines raise it (G, S, N) [dB], and the noise in each bin (G, S, B) [LSB^2]."""
        quiet = self.noise[0]
        if self.bursting:
            quiet = quiet + self.bursts.noise
        bands = self.model.recorded.bands
        return bands.raised(bands.with_power(quiet, self.random[1]), self.added, self.features.line)

    @functools.cached_property
    def distortion(self) -> Distortion:
        """What the effects' distortion changes."""
        return self.model.distortion(self.part, self.effects)

    @functools.cached_property
    def bursts(self) -> Bursts:
        """What the effects' bursts change."""
        return self.model.bursts(self.part, self.effects)

    @property
    def velocity(self) -> np.ndarray:
        """Slope that the reference shows in each group (G,) [m/s]."""
        return self.model.velocity(self.part.steady, self.effects)

    @property
    def displacement(self) -> np.ndarray:
        """Movement of each sweep within its group (n,) [m], one group after another."""
        return self.model.displacement(self.part, self.effects)


class Predictor:
    """The model of a recording's G groups; S stations with samples.

    Attributes:
        recorded: sweeps whose conditions, lines and jitter the model has.
        std: of the measured numbers by kind, which include the noise around lines and in the ramp.
        simulated: sweeps that the simulator makes.
        noise: that the model expects.
    """

    def __init__(self, recorded: RecordedSweeps, std: Mapping[str, np.ndarray]) -> None:
        """Prepare the model.

        Args:
            recorded: whose conditions, lines and jitter the model has.
            std: of the measured numbers by kind.
        """
        self.recorded, self.std = recorded, std
        self.noise = NoiseModel(recorded, np.isfinite(std['coherence']).any(axis=1))
        self.simulated = SimulatedSweeps(recorded, self.noise.loss, self.noise.additive_std)
        # what there is without any effect, by the first group of a part
        self._plain: dict[int, Expected] = {}
        self._undistorted: dict[tuple[int, tuple[Effect, ...]], tuple[np.ndarray, ...]] = {}
        # where the parts' groups and their sweeps stand, part after part
        group = np.concatenate([part.groups for part in recorded.parts])
        self._group_order = np.argsort(group)
        self._sweep_order = np.argsort(np.repeat(group, [len(recorded.members[g]) for g in group]), kind='stable')

    def expected(
        self, effects: Sequence[Effect], displaced: bool = False, outcome: int | None = None
    ) -> list[Expected]:
        """Return what the model with `effects` makes of the groups, setting by setting; see `Expected`."""
        if not effects:
            return [self.plain(part) for part in self.recorded.parts]
        return [Expected(self, part, tuple(effects), displaced, outcome) for part in self.recorded.parts]

    def plain(self, part: Part) -> Expected:
        """Return what the model without effects makes of the groups of one setting; kept."""
        first = int(part.groups[0])
        if first not in self._plain:
            self._plain[first] = Expected(self, part, ())
        return self._plain[first]

    def joined(self, found: Sequence[np.ndarray], per_sweep: bool) -> np.ndarray:
        """Return numbers of the parts' groups, or of their sweeps, as those of all in their order."""
        return np.concatenate(found)[self._sweep_order if per_sweep else self._group_order]

    def random_power(self, part: Part, effects: Sequence[Effect], bins: int) -> np.ndarray:
        """Return the power of random phase that effects add to each bin of spectra (G, S, B) [LSB^2]."""
        heard = self.recorded.heard
        result = np.zeros((len(part.groups), len(heard), bins))
        acting = [e for e in effects if type(e).random_power is not Effect.random_power]
        if not acting:
            return result
        state = acted(part, effects)
        rate = self.recorded.sample_rate
        # of real samples all power lies at positive frequencies
        width = rate if self.recorded.topology.iq else rate / 2.0
        frequency = np.arange(bins) * (rate / 2.0 / (bins - 1))
        for i, (number, window) in enumerate(zip(heard, part.extract.window_power, strict=True)):
            for effect in acting:
                result[:, i] += window * width * effect.random_power(state.stations[number], state, frequency)
        edged = np.pad(result, ((0, 0), (0, 0), (1, 1)), mode='edge')
        widened: np.ndarray = (edged[..., :-2] + 4.0 * result + edged[..., 2:]) / 6.0  # by a Hann window
        return widened

    @functools.lru_cache(maxsize=64)  # noqa: B019 they live as long as the recording is compared
    def changing(self, effects: tuple[Effect, ...]) -> np.ndarray:
        """Return by how much the ramp changes with the phase of each sweep, over the noise of one sweep (G, 2 S, K).

        What a spur or a mirror line brings has a phase of its own in every sweep, and so have the products of a
        distortion, and a second path on whose length the way of a drive acts. What effects of random phase do is
        predicted, see `Expected.fluttering`.
        """
        effects = tuple(e for e in effects if not (e.bursts or e.fluctuates))
        distorting = any(e.distorts for e in effects)
        result = np.zeros(self.std['flutter'].shape)
        for part in self.recorded.parts:
            if distorting:
                copies = SIMULATION.distorted
                features = self.simulated.jittered(part, effects, False, copies, shape=True)
            else:
                copies = 2
                features = self.simulated.copies(part, effects, copies)[0]
            result[part.groups] = _variance(features, copies)
            undistorted = tuple(e for e in effects if not e.distorts)
            speed = self.simulated.drive(part, undistorted)
            if speed is not None:
                copies = SIMULATION.distorted
                driven = self.simulated.copies(part, undistorted, copies, speed=speed)[0]
                result[part.groups] += _variance(driven, copies)
        return result / self.std['flutter']

    def quadratures(self, effects: Sequence[Effect]) -> np.ndarray:
        """Return what cosine and sine of the phase of each effect that fluctuates do to the ramp (E, 2, G, 2 S, K)."""
        found = [self.simulated.quadratures(part, effects) for part in self.recorded.parts]
        return np.concatenate(found, axis=2)[:, :, self._group_order]

    def distortion(self, part: Part, effects: Sequence[Effect]) -> Distortion:
        """Return by how much distortion changes noise, harmonics and piles.

        A limiter holds noise down, and noise carries a line across a limit that it does not reach by itself. So sweeps
        are simulated with noise, once with and once without the distortion.
        """
        others = tuple(e for e in effects if not e.distorts)
        known = int(part.groups[0]), others
        if known not in self._undistorted:
            while len(self._undistorted) >= SIMULATION.undistorted:
                del self._undistorted[next(iter(self._undistorted))]
            self._undistorted[known] = self._noisy(part, others)
        pairs = zip(self._noisy(part, effects), self._undistorted[known], strict=True)
        noise, harmonic, piled = (after - before for after, before in pairs)
        return Distortion(np.nan_to_num(noise), harmonic, piled)

    def _noisy(self, part: Part, effects: Sequence[Effect]) -> tuple[np.ndarray, ...]:
        """Return of noisy sweeps the noise in bands [dB of 1 LSB^2 per sample], harmonics, and samples piled up."""
        features = self.simulated.distorted(part, effects)
        counts = np.full(len(self.recorded.heard), SIMULATION.distorted)
        pairs = zip(features.power, features.line, strict=True)
        noise = np.array([self.recorded.bands.measured(*pair, counts) for pair in pairs])
        return noise, features.harmonic, features.piled

    def uneven(self, effects: tuple[Effect, ...]) -> np.ndarray:
        """Return by how much distortion makes noise uneven (G, S, NUMBERS), of a setting at the first of its groups.

        Sweeps as strong as the recorded ones are simulated among the same noise with and without the distortion.
        """
        result = np.zeros(self.std['burst'].shape)
        for part, (after, _), (before, _) in self._with_and_without(effects):
            result[part.groups[0]] = after - before
        return result

    def scattering(self, effects: tuple[Effect, ...]) -> np.ndarray:
        """Return how far distortion changes a group's noise in bands by chance (G, S, N) [dB].

        It depends on the phases at which the samples meet a limit, hence in each sweep on its own: most where a line
        is near a simple part of the sampling rate. Sweeps are simulated as by `uneven`.
        """
        result = np.zeros(self.std['noise'].shape)
        for part, (_, after), (_, before) in self._with_and_without(effects):
            result[part.groups] = np.std(np.nan_to_num(after - before), axis=1, ddof=1)
        # the model is the mean of few sweeps, too
        chance: np.ndarray = np.sqrt(1.0 / SIMULATION.distorted + 1.0 / self.recorded.quiet_counts)
        return result * chance[..., None]

    def _with_and_without(
        self, effects: tuple[Effect, ...]
    ) -> Iterator[tuple[Part, tuple[np.ndarray, np.ndarray], tuple[np.ndarray, np.ndarray]]]:
        """Yield each part with what `_of_each_sweep` returns with the distortion, and without it."""
        effects = tuple(e for e in effects if not (e.bursts or e.fluctuates))
        undistorted = tuple(e for e in effects if not e.distorts)
        for part in self.recorded.parts:
            yield part, self._of_each_sweep(part, effects), self._of_each_sweep(part, undistorted)

    @functools.lru_cache(maxsize=64)  # noqa: B019 they live as long as the recording is compared
    def _of_each_sweep(self, part: Part, effects: tuple[Effect, ...]) -> tuple[np.ndarray, np.ndarray]:
        """Return how unevenly noise is spread over simulated sweeps as strong as the recorded ones (S, NUMBERS).

        And the noise in bands of each (G, copies, S, N) [dB of 1 LSB^2 per sample].
        """
        copies = SIMULATION.bursting
        found = self.simulated.jittered(part, effects, True, copies, quiet=True, as_measured=True)
        quiet, surge = (_by_group(x, copies) for x in (found.quiet, found.surge))
        uneven = [unevenness(list(quiet[:, :, i]), list(surge[:, :, i]))[0] for i in range(quiet.shape[2])]
        once = np.ones(len(self.recorded.heard))
        pairs = zip(found.power, found.line, strict=True)
        bands = np.array([self.recorded.bands.measured(*pair, once) for pair in pairs])
        return np.array(uneven), _by_group(bands, copies)

    def bursts(self, part: Part, effects: Sequence[Effect]) -> Bursts:
        """Return what bursts do, by sweeps simulated among the same noise with and without them.

        All of the simulated sweeps hold a burst, and count by the share of sweeps that do. Bursts of two effects rarely
        come in one sweep.
        """
        even, plain = self._mixed(part, None)
        mixed = [self._mixed(part, effect) for effect in effects if effect.bursts]
        uneven = np.sum([found - even for found, _ in mixed], axis=0)
        noise = np.sum([np.nan_to_num(bands - plain) for _, bands in mixed], axis=0)
        return Bursts(uneven, noise)

    @functools.lru_cache(maxsize=16)  # noqa: B019 they live as long as the recording is compared
    def _among_noise(self, part: Part, effect: Effect | None) -> tuple[np.ndarray, ...]:
        """Return power in spans, surges, spectra (G, n, S, ...) and lines (G, S) of n noisy sweeps of each group."""
        copies = min(max(map(len, part.local)), SIMULATION.bursting)
        effects = (effect,) if effect is not None else ()
        found = self.simulated.jittered(part, effects, True, copies, quiet=True)
        quiet, surge, power, line = (_by_group(x, copies) for x in (found.quiet, found.surge, found.power, found.line))
        return quiet, surge, power, line.mean(axis=1)

    @functools.lru_cache(maxsize=64)  # noqa: B019 they live as long as the recording is compared
    def _mixed(self, part: Part, effect: Effect | None) -> tuple[np.ndarray, np.ndarray]:
        """Return the unevenness (S, K) and the noise in bands between bursts (G, S, N) [dB].

        Args:
            part: groups of one setting.
            effect: whose bursts some of the sweeps hold; None: of sweeps without.
        """
        steady = bursting = self._among_noise(part, None)
        share = 0.0
        if effect is not None:
            always, share = effect.in_each_sweep()
            bursting = self._among_noise(part, always)
        pairs = zip(steady[:3], bursting[:3], strict=True)
        quiet, surge, power = (np.concatenate(x, axis=1) for x in pairs)
        line = steady[3]
        copies = steady[0].shape[1]
        weights = np.repeat([max(1.0 - share, SIMULATION.least_share), share], copies)
        uneven = [unevenness(list(quiet[:, :, i]), list(surge[:, :, i]), weights)[0] for i in range(quiet.shape[2])]
        bands = []
        for of_group, spectra, at in zip(quiet, power, line, strict=True):
            free = quiet_sweeps(of_group, spectra, slice(copies)) * weights[:, None]
            mean, count = mean_power(spectra, free)
            bands.append(self.recorded.bands.measured(mean, at, count))
        return np.array(uneven), np.array(bands)

    def placed(self, part: Part, effects: Sequence[Effect], displaced: bool = False) -> tuple[Part, np.ndarray]:
        """Return where the model has its groups, and what the reference says there (G,) [m]; see `Expected`.

        An error of the reference means that the target stands elsewhere. To first order that changes the range alone;
        but a reflection follows the true distance, which its phase shows to a part of the carrier's wavelength.
        """
        reading = self._reference(part, effects)
        error = reading - part.steady.range
        if displaced:
            error = error - self.recorded.reference_noise[part.groups]
        if not error.any() or not any(map(shows_place, effects)):
            return part, reading
        steady = part.steady.rows(slice(None))
        move(steady, -error)
        return dataclasses.replace(part, steady=steady), part.steady.range

    def distances(self, effects: Sequence[Effect]) -> np.ndarray:
        """Return where the groups are if effects of the reference act (G,) [m]."""
        found = [2.0 * part.steady.range - self._reference(part, effects) for part in self.recorded.parts]
        return self.joined(found, per_sweep=False)

    def _reference(self, part: Part, effects: Sequence[Effect]) -> np.ndarray:
        """Return what the reference says in each group (G,) [m]; its errors move the model's distance the other way.

        The readings' slope is noisy: where an effect drives the crane, its velocity stands for it.
        """
        m = part.steady
        slope = self.recorded.speed[part.groups]
        if any(effect.motion is Motion.DRIVE for effect in effects):
            slope = self.velocity(m, effects)

        def distance_at(time: np.ndarray | float) -> np.ndarray:
            return m.range + slope * (time - m.time)

        reading = m.range.copy()
        for effect in effects:
            reading = reading + effect.reference_error(m.time, m.range, distance_at)
        return reading

    def velocity(self, m: Measurements, effects: Sequence[Effect]) -> np.ndarray:
        """Return the slope that the reference shows in each group [m/s] (G,): it sees the crane drive, not sway."""
        driving = [effect for effect in effects if effect.motion is Motion.DRIVE]
        if not driving:
            return m.velocity
        driven = m.rows(slice(None))
        for effect in driving:
            effect.prepare(driven)
        return driven.velocity

    def displacement(self, part: Part, effects: Sequence[Effect]) -> np.ndarray:
        """Return the movement within each group beyond what the reference shows [m], one group after another."""
        # geometry follows the distance, of which each sweep has a reading with noise but a standing crane has one
        moving = [e for e in effects if ActsOn.DELAY in e.acts_on and e.of is Of.PATH and e.stage != Stage.GEOMETRY]
        if not moving:
            return np.zeros(len(part.all))
        steadied, moved = part.all.rows(slice(None)), part.all.rows(slice(None))
        for group, local in zip(part.groups, part.local, strict=True):
            if self.recorded.standing[group]:  # likewise what air adds to each distance
                for values in (steadied.paths[0].delay, moved.paths[0].delay, moved.range):
                    values[local] = values[local].mean()
        for effect in moving:
            effect.prepare(moved)
        way = (moved.paths[0].delay - steadied.paths[0].delay) * SPEED_OF_LIGHT / part.all.refractive_index
        creep = (self.velocity(part.all, effects) - part.all.velocity) * part.all.time
        sweep = part.extract.sweeps[0]
        doppler = doppler_range_rate(sweep.center_frequency, sweep.chirp_rate, 0.5 * sweep.ramp_duration)
        shifted = way + doppler * (moved.velocity - part.all.velocity)
        ways = []
        for group, local in zip(part.groups, part.local, strict=True):
            by_phase, slow = self.recorded.counted[group], self.recorded.standing[group]
            # a creep is slower than the reference could show
            ways.append((way if by_phase else shifted)[local] + (creep[local] if slow else 0.0))
        return np.concatenate([w - w.mean() for w in ways])


def _by_group(values: np.ndarray, copies: int) -> np.ndarray:
    """Return numbers of copies of each group (copies G, ...), as `jittered` returns them, by group (G, copies, ...)."""
    return values.reshape(copies, -1, *values.shape[1:]).swapaxes(0, 1)


def _variance(features: SweepFeatures, copies: int) -> np.ndarray:
    """Return the variance of the ramp's terms over copies of sweeps (G, 2 S, K)."""
    terms = ramp_spectrum(features.ramp)
    variance: np.ndarray = terms.reshape(copies, -1, *terms.shape[1:]).var(axis=0, ddof=1)
    return variance
