"""Sweeps that the simulator makes as the recorded ones are: free of noise, or with their jitter and among noise.

A limiter holds a sample that noise carries beyond the limit, and noise has a mean behind an even characteristic. So
sweeps free of noise have, where effects distort, the mean over the noise of each sample.
"""

import dataclasses
import functools
from collections.abc import Callable, Sequence

import numpy as np

from drfmcw_node.estimators.spectral import parabola_vertex
from drfmcw_physics.constants import SPEED_OF_LIGHT
from drfmcw_sim.effects import ActsOn, Effect, Motion, Stage
from drfmcw_sim.measurements import Measurements
from drfmcw_sim.synthesis.signal_model import synthesise

from ..features.extractor import SweepFeatures, ramp_spectrum
from .groups import Part, acted, align, in_phase, move
from .limits import SIMULATION
from .recorded_sweeps import RecordedSweeps

_UNSEEN = ActsOn.NOISE | ActsOn.REFERENCE  # in sweeps free of noise and of distortion
_Loss = Callable[[Part, Measurements], np.ndarray]
_NoiseStd = Callable[[Part, Measurements, Sequence[Effect]], np.ndarray]


class SimulatedSweeps:
    """Features of simulated sweeps under the conditions of a recording's groups, S stations with samples."""

    def __init__(self, recorded: RecordedSweeps, loss: _Loss, noise_std: _NoiseStd) -> None:
        """Remember what simulated sweeps have of others.

        Args:
            recorded: sweeps whose jitter simulated ones have.
            loss: returns what phase noise takes of the lines of a part's groups, under conditions (G, S) [dB].
            noise_std: returns the standard deviation of the additive noise of each sample under conditions after
                effects, of I and Q apart (G, S) [LSB].
        """
        self._recorded, self._loss, self._noise_std = recorded, loss, noise_std
        self._leaking: set[int] = set()  # parts, by their first groups, into whose lines mirror lines leak

    def mean(self, part: Part, effects: Sequence[Effect]) -> SweepFeatures:
        """Return the features of one noise-free sweep pair per group; harmonics only where an effect makes some.

        Mean of sweeps whose phases lie evenly over half a turn: what mirror lines and harmonics leak cancels in them,
        as it does in a recording's sweeps of random phase; over a whole turn what is added to the samples does too.
        Where an effect has a random phase, the mean is also that over its phases.
        """
        seen = _seen(effects)
        turns = SIMULATION.turns if any(e.fluctuates for e in seen) else SIMULATION.turns[:1]
        each = [self._noise_free(part, tuple(e.in_one_sweep(turn) for e in seen)) for turn in turns]
        return each[0] if len(each) == 1 else _mean(_joined(each), len(each))

    def fluttering(self, part: Part, effects: Sequence[Effect]) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Return the variance of the ramp's terms over the random phases of effects, without noise, and its scatter.

        A group's sweeps have some phases by chance: the mean of their cosines and sines is not quite zero, nor the mean
        square of one that of the other.

        Returns:
            variance over all phases (G, 2 S, K), and independent standard deviations of the mean and of the variance
            of a group's sweeps, two of each effect that fluctuates (2 E, G, 2 S, K).
        """
        counts = np.array([len(self._recorded.members[g]) for g in part.groups])[:, None, None]
        waves = self.quadratures(part, effects)
        of_mean = [wave / np.sqrt(2.0 * counts) for pair in waves for wave in pair]
        of_variance = [
            x / np.sqrt(8.0 * counts) for cosine, sine in waves for x in (cosine**2 - sine**2, 2.0 * cosine * sine)
        ]
        total = np.sum(waves**2, axis=(0, 1)) / 2.0
        return total, np.array(of_mean), np.array(of_variance)

    def quadratures(self, part: Part, effects: Sequence[Effect]) -> np.ndarray:
        """Return what cosine and sine of the phase of each effect that fluctuates do to the ramp (E, 2, G, 2 S, K)."""
        seen = _seen(effects)
        at_start = tuple(e.in_one_sweep(SIMULATION.turns[0]) for e in seen)
        turn = 2.0 * np.pi * np.array(SIMULATION.turns)
        found = np.zeros((0, 2, *self._noise_free(part, at_start).ramp.shape))
        for number, effect in enumerate(seen):
            if effect.fluctuates:  # the phases of several are independent
                before, after = at_start[:number], at_start[number + 1 :]
                turned = [(*before, effect.in_one_sweep(t), *after) for t in SIMULATION.turns]
                terms = np.array([ramp_spectrum(self._noise_free(part, each).ramp) for each in turned])
                waves = [np.tensordot(wave(turn), terms, 1) * 2.0 / len(turn) for wave in (np.cos, np.sin)]
                found = np.concatenate([found, np.array(waves)[None]])
        return found

    @functools.lru_cache(maxsize=64)  # noqa: B019 they live as long as the recording is compared
    def _noise_free(self, part: Part, effects: tuple[Effect, ...]) -> SweepFeatures:
        distorting = any(effect.distorts for effect in effects)
        swaying = tuple(effect for effect in effects if effect.motion is Motion.SWAY)
        heard = ('', *self._recorded.topology.receivers)
        received = [e for e in effects if ActsOn.SAMPLES in e.acts_on and e.station in heard]
        added = any(effect.stage <= Stage.FILTER for effect in received)
        speed = self.drive(part, effects)
        if distorting or speed is not None:
            copies = SIMULATION.distorted
        else:
            copies = self._places(part, swaying) if swaying else 4 if added else 2
        many, places = copies == SIMULATION.distorted, copies if swaying else 0
        # half a turn leaves the mean of leakage, transients and even harmonics
        turns = 1.0 if added or distorting else 0.5
        simulated = functools.partial(
            self.copies, part, effects, places=places, harmonic=not effects, turns=turns, speed=speed
        )
        # where mirror lines leaked into the sweeps simulated last, twice as many are made at once
        first = int(part.groups[0])
        made = 1 + (not many and first in self._leaking)
        each, moved = simulated(made * copies)
        needed = 1 + (not many and _spread_of_ramp(each, copies, made) > SIMULATION.mirrored)
        if needed != made:
            self._leaking ^= {first}
            each, moved = simulated(needed * copies)
        copies *= needed
        features = _mean(each, copies)
        if np.any(moved):
            farther = moved * SPEED_OF_LIGHT / part.steady.refractive_index
            features = dataclasses.replace(features, range=features.range - farther)
        if distorting:
            features = dataclasses.replace(features, power=self._harmonics(part, effects, copies))
        return features

    def _harmonics(self, part: Part, effects: tuple[Effect, ...], copies: int) -> np.ndarray:
        """Return mean spectra (G, S, B) of sweeps as strong, and at the frequencies, as those in the recorded spectra.

        The few sweeps that alone reach a limit may pass for ones with a burst. A harmonic multiplies by how much its
        line is off: by the jitter, and by what no clock of the explanation accounts for yet.
        """
        undistorted = tuple(e for e in effects if not (e.distorts or e.bursts))
        names = [part.steady.stations[heard].name for heard in self._recorded.heard]
        distorted = (n for n, name in enumerate(names) if any(e.distorts and e.applies_to(name) for e in effects))
        station = next(distorted, 0)
        some = not all(self._recorded.sweeps[group].free.all() for group in part.groups)
        rows = self._raised(part, self._needed(part, tuple(e for e in effects if not e.bursts), copies, some))
        beats = np.stack([self._beats(group, copies, station) for group in part.groups], axis=1)
        late = (beats - self._noise_free(part, undistorted).beat) / part.extract.beat_per_start_delay
        rows.start_delay += late.ravel()
        align(part, rows, copies, self._recorded.sweeps, effects)
        power: np.ndarray = _mean(self._features(part, rows, effects, shape=False), copies).power
        return power

    def drive(self, part: Part, effects: Sequence[Effect]) -> np.ndarray | None:
        """Return the speed of each group's drive (G,) [m/s], None unless a second path's phase turns within a group.

        A reflection's excess delay follows the distance; what it adds to a driving group is the mean over its way.
        """
        way = self._recorded.way[part.groups]
        if not way.any():
            return None
        excess = []
        for place in (-0.5, 0.5):
            steady = part.steady.rows(slice(None))
            move(steady, place * way)
            state = acted(dataclasses.replace(part, steady=steady), effects)
            excess.append(np.array([path.delay - state.paths[0].delay for path in state.paths[1:]]))
        carrier = part.extract.sweeps[0].center_frequency
        turns = np.any(np.abs(excess[1] - excess[0]) * carrier > SIMULATION.turning)
        return self._recorded.speed[part.groups] if turns else None

    def copies(
        self,
        part: Part,
        effects: Sequence[Effect],
        copies: int,
        places: int = 0,
        harmonic: bool = False,
        turns: float = 0.5,
        speed: np.ndarray | None = None,
    ) -> tuple[SweepFeatures, np.ndarray]:
        """Return features of sweeps, their phases evenly over so many turns, and the delay added to them (G,).

        Where the crane sways, they are at so many `places` of it. Those of a drive lie all along its way, if its speed
        is given (G,) [m/s].
        """
        count = len(part.groups)
        rows = part.steady.rows(np.tile(np.arange(count), copies))
        rows.initial_phase[0] += np.repeat(np.arange(copies) * (turns / copies), count)
        if places:  # a group's mean is that over its time, in which a crane may swing far
            rows.time += np.resize(self._times(part, places), (copies, count)).ravel()
        if speed is not None:
            move(rows, (self._times(part, copies) * speed).ravel())
        elsewhere, alone = places > 0 or speed is not None, self._recorded.topology.hears_itself
        if elsewhere and not alone:
            moved = in_phase(part, rows, copies, effects)
        else:
            moved = align(part, rows, copies, self._recorded.sweeps, effects)
        # copies of a station that hears itself differ in their delays
        alike = 1 if elsewhere or alone else copies
        return self._features(part, rows, effects, harmonic=harmonic, copies=alike), moved

    def jittered(
        self,
        part: Part,
        effects: Sequence[Effect],
        noise: bool,
        copies: int,
        harmonic: bool = False,
        quiet: bool = False,
        shape: bool = False,
        as_measured: bool = False,
    ) -> SweepFeatures:
        """Return power and lines of sweeps with start delays and amplitudes of measured ones, (copies x groups, ...).

        Harmonics multiply the jitter. Where effects distort, lines are as strong as the measured ones: how many samples
        a limiter holds depends on a tenth of a decibel. Otherwise each group has the model's mean, unless
        `as_measured`.

        Args:
            part: groups of one setting.
            effects: that act.
            noise: whether there is any.
            copies: sweeps of each group.
            harmonic: see `Extractor`, like the following.
            quiet: see there.
            shape: see there.
            as_measured: make all lines as strong as the measured ones.
        """
        if as_measured or any(effect.distorts for effect in effects):
            powers = self._needed(part, tuple(e for e in effects if not e.bursts), copies, False)
        else:
            amplitudes = self._amplitudes(part, copies)
            powers = amplitudes - amplitudes.mean(axis=0)
        rows = self._raised(part, powers)
        rows.sweep_id = np.arange(len(rows))
        delays = np.stack([self._start_delays(g, copies) for g in part.groups], axis=1)
        rows.start_delay += delays.ravel()
        align(part, rows, copies, self._recorded.sweeps, effects)
        return self._features(part, rows, effects, noise, harmonic, quiet=quiet, shape=shape)

    def _raised(self, part: Part, powers: np.ndarray) -> Measurements:
        """Return copies of a part's groups whose received power is raised by `powers` (copies, G, S) [dB]."""
        rows = part.steady.rows(np.tile(np.arange(len(part.groups)), len(powers)))
        for number, heard in enumerate(self._recorded.heard):
            rows.stations[heard].received_power += powers[..., number].ravel()
        return rows

    @functools.lru_cache(maxsize=64)  # noqa: B019 they live as long as the recording is compared
    def _needed(self, part: Part, effects: tuple[Effect, ...], copies: int, free: bool) -> np.ndarray:
        """Return by how much to raise the received power of sweeps, so that lines are as measured (copies, G, S) [dB].

        Deep in a limit the line hardly says how strong it came in: then the link budget does. `free` as for
        `_amplitudes`.
        """
        amplitudes = self._amplitudes(part, copies, free)
        loss = self._loss(part, acted(part, effects))
        effects = _seen(effects)
        plain = self._noise_free(part, tuple(e for e in effects if not e.distorts))
        wanted = amplitudes + loss - plain.amplitude  # rise of a line
        if not any(effect.distorts for effect in effects):
            return wanted
        budget = amplitudes - amplitudes.mean(axis=0)
        lowest = np.minimum(wanted[0], budget[0]) - SIMULATION.limit_known
        highest = np.maximum(wanted[-1], budget[-1]) + SIMULATION.beyond
        steps = np.linspace(0.0, 1.0, SIMULATION.fine)
        levels, rise = np.empty((2, SIMULATION.levels, *lowest.shape))
        bent = np.ones(len(part.groups), bool)
        for _ in range(2):  # first roughly
            if bent.any():
                levels[:, bent] = np.linspace(lowest[bent], highest[bent], SIMULATION.levels)
                rise[:, bent] = self._rise(_of_groups(part, bent), effects, levels[:, bent], plain.amplitude[bent])
                curved = np.abs(np.diff(rise, 2, axis=0)) / 8.0  # by how much a straight line is off in between
                bent = np.any(curved > SIMULATION.straight, axis=(0, 2))
            found = np.empty(wanted.shape)
            for at in np.ndindex(plain.amplitude.shape):
                of = (slice(None), *at)
                tried = lowest[at] + steps * (highest[at] - lowest[at])
                found[of] = _likeliest(tried, np.interp(tried, levels[of], rise[of]), wanted[of], budget[of])
            lowest, highest = found[0] - SIMULATION.limit_known, found[-1] + SIMULATION.limit_known
        return found

    def _rise(self, part: Part, effects: Sequence[Effect], levels: np.ndarray, plain: np.ndarray) -> np.ndarray:
        """Return by how much lines rise above `plain` ones where the received power does by `levels`.

        Args:
            part: groups of one setting.
            effects: that act.
            levels: rise of the received power (L, G, S) [dB].
            plain: amplitude at level 0 without distortion (G, S) [dB of 1 LSB].

        Returns:
            rise of the lines (L, G, S) [dB].
        """
        rows = self._raised(part, levels)
        align(part, rows, len(levels), self._recorded.sweeps, effects)
        lines = part.extract.amplitude(self._heard(part, rows, effects))
        return lines.reshape(len(levels), *plain.shape) - plain

    def samples(self, part: Part, effects: Sequence[Effect], noise: bool) -> tuple[np.ndarray, ...]:
        """Return one sweep per group before the ADC, of each station with samples (G, N), with iq (G, 2 N) [LSB]."""
        rows = part.steady.rows(slice(None))
        samples = synthesise(rows, 0, effects, noise, False)
        return tuple(samples[i].reshape(len(rows), -1) for i in self._recorded.heard)

    def distorted(self, part: Part, effects: Sequence[Effect]) -> SweepFeatures:
        """Return means over noisy sweeps of `jittered` as strong as measured, with harmonics."""
        copies = SIMULATION.distorted
        return _mean(self.jittered(part, effects, True, copies, harmonic=True, as_measured=True), copies)

    def _features(
        self,
        part: Part,
        rows: Measurements,
        effects: Sequence[Effect],
        noise: bool = False,
        harmonic: bool = False,
        copies: int = 1,
        quiet: bool = False,
        shape: bool = True,
    ) -> SweepFeatures:
        """Return features of simulated sweeps, only those that are wanted; `copies` as for `synthesise`."""
        heard = self._heard(part, rows, effects, noise, copies)
        full_scale = rows.stations[self._recorded.heard[0]].full_scale
        found = part.extract(heard, full_scale, rows.refractive_index, harmonic, quiet, noisy=False, shape=shape)
        if not shape:
            return found
        group = np.resize(part.groups, len(rows))
        return dataclasses.replace(found, ramp=self._recorded.without_uneven(found.ramp, group))

    def _heard(
        self, part: Part, rows: Measurements, effects: Sequence[Effect], noise: bool = False, copies: int = 1
    ) -> tuple[np.ndarray, ...]:
        """Return samples of each station with samples (n, N), with iq (n, 2 N) [LSB]; `copies` as for `synthesise`."""
        if noise or not any(effect.distorts for effect in effects):
            samples = synthesise(rows, 0, effects, noise, False, copies)
        else:
            samples = self._mean_samples(part, rows, effects, copies)
        return tuple(samples[i].reshape(len(rows), -1) for i in self._recorded.heard)

    def _mean_samples(
        self, part: Part, rows: Measurements, effects: Sequence[Effect], copies: int
    ) -> tuple[np.ndarray, ...]:
        """Return samples that effects distort, each the mean over its noise, by quadrature; as `synthesise`."""
        distorting = sorted((e for e in effects if e.distorts), key=lambda e: e.stage)
        undistorted = synthesise(rows, 0, [e for e in effects if not e.distorts], False, False, copies)
        std = self._noise_std(part, acted(part, effects), effects)
        nodes, weights = np.polynomial.hermite_e.hermegauss(SIMULATION.nodes)
        found = list(undistorted)
        for station, heard in enumerate(self._recorded.heard):
            own = [effect for effect in distorting if effect.applies_to(rows.stations[heard].name)]
            if not own:
                continue
            clean = undistorted[heard]
            away = np.resize(std[:, station], len(rows)).astype(np.float32).reshape(-1, *(1,) * (clean.ndim - 1))
            found[heard] = np.zeros_like(clean)
            for node, weight in zip(nodes, weights / weights.sum(), strict=True):
                samples = clean + np.float32(node) * away
                for effect in own:
                    effect.receive(samples, rows.stations[heard], rows, list)
                found[heard] += np.float32(weight) * samples
        return tuple(found)

    def _places(self, part: Part, swaying: Sequence[Effect]) -> int:
        """Return at how many places of a sway to simulate sweeps: the fewest that have the mean of all, or nearly."""
        counts = [len(self._recorded.members[g]) for g in part.groups]
        number = np.repeat(np.arange(len(counts)), counts)
        time = np.concatenate([self._time(g) for g in part.groups])
        first = np.cumsum([0, *counts[:-1]])
        mean = np.add.reduceat(self._way(part, swaying, number, time), first) / counts
        errors = {}
        for places in (*map(len, SIMULATION.quadrature), SIMULATION.distorted):
            at = self._times(part, places)
            way = self._way(part, swaying, np.tile(np.arange(len(counts)), places), at.ravel())
            errors[places] = np.abs(way.reshape(places, -1).mean(axis=0) - mean).max()
            if errors[places] < SIMULATION.misplaced:
                break
        return min(errors, key=errors.__getitem__)

    def _way(self, part: Part, effects: Sequence[Effect], group: np.ndarray, time: np.ndarray) -> np.ndarray:
        """Return how far groups are by their numbers at times from their mean (n,) [m]."""
        rows = part.steady.rows(group)
        rows.time += time
        state = acted(dataclasses.replace(part, steady=rows), effects)
        way: np.ndarray = state.paths[0].delay * SPEED_OF_LIGHT
        return way

    def _time(self, group: int) -> np.ndarray:
        """Return times of a group's sweeps, from their mean [s]."""
        time = self._recorded.data.time[self._recorded.members[group]]
        return np.asarray(time - time.mean())

    def _times(self, part: Part, count: int) -> np.ndarray:
        """Return times spread over each group's sweeps, from their mean [s] (count, G)."""
        each = (self._time(g) for g in part.groups)
        return np.stack([np.interp(_spread_evenly(count, len(t)), np.arange(len(t)), t) for t in each], axis=1)

    def _amplitudes(self, part: Part, count: int, free: bool = False) -> np.ndarray:
        """Return amplitudes that stand for those of a part's sweeps (count, G, S), in rising order [dB of 1 LSB].

        Either all sweeps count or, if `free`, those without a burst.
        """
        found = []
        for group in part.groups:
            sweeps = self._recorded.sweeps[group]
            each = [a[f | (not free)] for a, f in zip(sweeps.amplitude.T, sweeps.free.T, strict=True)]
            found.append([np.interp(_middles(count, len(a)), np.arange(len(a)), np.sort(a)) for a in each])
        return np.moveaxis(np.array(found), 2, 0)

    def _beats(self, group: int, count: int, station: int) -> np.ndarray:
        """Return the beats of sweeps without a burst in rising order of a station's amplitude (count,) [Hz]."""
        sweeps = self._recorded.sweeps[group]
        order = np.argsort(sweeps.amplitude[:, station])
        order = order[sweeps.free[order, station]]
        beats: np.ndarray = sweeps.beat[order[np.rint(_middles(count, len(order))).astype(int)]]
        return beats

    def _start_delays(self, group: int, count: int) -> np.ndarray:
        """Return T_off minus the group's mean, of `count` of its sweeps [s]."""
        return _spread(self._recorded.sweeps[group].beat, count) / self._recorded.parts[0].extract.beat_per_start_delay


def _of_groups(part: Part, chosen: np.ndarray) -> Part:
    """Return some groups of a part alone, by a mask (G,), with their steady conditions."""
    return dataclasses.replace(part, groups=part.groups[chosen], steady=part.steady.rows(chosen))


def _middles(count: int, length: int) -> np.ndarray:
    """Return the places of the middles of `count` equal parts of a list (count,)."""
    places: np.ndarray = (np.arange(count) + 0.5) / count * length - 0.5
    return places


def _spread_evenly(count: int, length: int) -> np.ndarray:
    """Return places in a list (count,) at which the mean of a smooth course is nearly that of all.

    Those of Chebyshev's quadrature where there are few, else the middles of equal parts. A quadrature's mean square,
    1/3, is brought to that of all places.
    """
    for places in SIMULATION.quadrature:
        if count == len(places):
            return np.asarray(0.5 * (length - 1) + 0.5 * np.sqrt(length**2 - 1.0) * np.array(places))
    return _middles(count, length)


def _spread(values: np.ndarray, count: int) -> np.ndarray:
    """Return the values of `count` sweeps spread over a group's (n, ...), less the mean of all."""
    return values[np.linspace(0, len(values) - 1, count).astype(int)] - values.mean(axis=0)


def _likeliest(tried: np.ndarray, reached: np.ndarray, wanted: np.ndarray, budget: np.ndarray) -> np.ndarray:
    """Return which rise of the received power is the likeliest of each sweep (n,) [dB].

    A line that a limit holds says little of it, since the limit's own level is to be found. A parabola through the
    likeliest rise tried and those beside it lets the result follow a parameter without steps.

    Args:
        tried: rises of the received power, evenly spaced (M,) [dB].
        reached: rise of the line at each (M,) [dB].
        wanted: rise of each sweep's line (n,) [dB].
        budget: rise of its received power by the link budget (n,) [dB].
    """
    held = np.abs(1.0 - np.gradient(reached) / (tried[1] - tried[0]))
    std = SIMULATION.line_known + SIMULATION.limit_known * held
    unlikely = ((wanted[:, None] - reached) / std) ** 2 + 2.0 * np.log(std)
    unlikely += ((tried - budget[:, None]) / SIMULATION.budget_known) ** 2
    least = np.clip(np.argmin(unlikely, axis=1), 1, len(tried) - 2)
    three = np.take_along_axis(-unlikely, least[:, None] + np.arange(-1, 2), axis=1).T
    return tried[least] + parabola_vertex(*three) * (tried[1] - tried[0])


def _seen(effects: Sequence[Effect]) -> tuple[Effect, ...]:
    """Return the effects that show in sweeps free of noise; one of the noise does where others distort it."""
    distorting = any(effect.distorts for effect in effects)
    unseen = ActsOn.REFERENCE if distorting else _UNSEEN
    return tuple(e for e in effects if e.acts_on & ~unseen)


def _joined(each: Sequence[SweepFeatures]) -> SweepFeatures:
    """Return the features of several copies of sweeps as those of one after another."""
    names = [f.name for f in dataclasses.fields(SweepFeatures) if f.name != 'time']
    values = {name: np.concatenate([getattr(features, name) for features in each]) for name in names}
    return dataclasses.replace(each[0], **values)


def _spread_of_ramp(features: SweepFeatures, copies: int, step: int) -> float:
    """Return how far the ramps of so many copies, every `step` th, lie apart at most: by what mirror lines leak."""
    return float(np.max(np.ptp(features.ramp.reshape(copies * step, -1)[::step], axis=0), initial=0.0))


def _mean(features: SweepFeatures, copies: int) -> SweepFeatures:
    """Return the means of copies of sweeps, of each group."""
    count = len(features.carrier) // copies
    means = {
        f.name: getattr(features, f.name).reshape(copies, count, *getattr(features, f.name).shape[1:]).mean(axis=0)
        for f in dataclasses.fields(SweepFeatures)
        if f.name not in ('time', 'carrier')
    }
    return dataclasses.replace(features, **means, carrier=features.carrier[:count])
