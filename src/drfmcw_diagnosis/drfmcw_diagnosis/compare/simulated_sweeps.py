"""Sweeps that the simulator makes as the recorded ones are: free of noise, or with their jitter and among noise."""

import dataclasses
import functools
from collections.abc import Sequence

import numpy as np

from drfmcw_physics.constants import SPEED_OF_LIGHT
from drfmcw_sim.effects import ActsOn, Effect, Motion, Stage
from drfmcw_sim.measurements import Measurements
from drfmcw_sim.signal_model import synthesise

from ..features.extractor import SweepFeatures
from .groups import Part, align
from .limits import SIMULATION
from .recorded_sweeps import RecordedSweeps

_UNSEEN = ActsOn.NOISE | ActsOn.REFERENCE  # in sweeps free of noise


class SimulatedSweeps:
    """Features of simulated sweeps under the conditions of a recording's groups, S stations with samples."""

    def __init__(self, recorded: RecordedSweeps) -> None:
        """Remember the recorded sweeps, whose jitter simulated ones have."""
        self._recorded = recorded

    def mean(self, part: Part, effects: Sequence[Effect]) -> SweepFeatures:
        """Return the features of one noise-free sweep pair per group; harmonics only where an effect makes some.

        Mean of sweeps whose phases lie evenly over half a turn: what mirror lines and harmonics leak cancels in them,
        as it does in a recording's sweeps of random phase; over a whole turn what is added to the samples does too.
        """
        return self._noise_free(part, tuple(e for e in effects if e.acts_on & ~_UNSEEN))

    @functools.lru_cache(maxsize=64)  # noqa: B019 they live as long as the recording is compared
    def _noise_free(self, part: Part, effects: tuple[Effect, ...]) -> SweepFeatures:
        distorting = any(effect.distorts for effect in effects)
        swaying = any(effect.motion is Motion.SWAY for effect in effects)
        added = any(ActsOn.SAMPLES in effect.acts_on and effect.stage < Stage.FILTER for effect in effects)
        copies = SIMULATION.distorted if distorting or swaying else 4 if added else 2
        turns = 1.0 if added else 0.5
        each, moved = self.copies(part, effects, copies, swaying, not effects, turns)
        features = _mean(each, copies)
        if np.any(moved):
            way = moved * SPEED_OF_LIGHT / part.steady.refractive_index
            features = dataclasses.replace(features, range=features.range - way)
        if distorting:
            jittered = _mean(self.jittered(part, effects, False, copies), copies)
            features = dataclasses.replace(features, power=jittered.power)
        return features

    def copies(
        self,
        part: Part,
        effects: Sequence[Effect],
        copies: int,
        swaying: bool = False,
        harmonic: bool = False,
        turns: float = 0.5,
    ) -> tuple[SweepFeatures, np.ndarray]:
        """Return features of sweeps, their phases evenly over so many turns, and the delay that `align` added (G,)."""
        count = len(part.groups)
        rows = part.steady.rows(np.tile(np.arange(count), copies))
        rows.initial_phase[0] += np.repeat(np.arange(copies) * (turns / copies), count)
        if swaying:  # a group's mean is that over its time, in which a crane may swing far
            rows.time += np.stack([self._times(g, copies) for g in part.groups], axis=1).ravel()
        moved = align(part, rows, copies, self._recorded.sweeps, effects)
        # copies of a station that hears itself differ in their delays
        alike = 1 if swaying or self._recorded.topology.hears_itself else copies
        return self._features(part, rows, effects, harmonic=harmonic, copies=alike), moved

    def jittered(
        self,
        part: Part,
        effects: Sequence[Effect],
        noise: bool,
        copies: int,
        harmonic: bool = False,
        quiet: bool = False,
    ) -> SweepFeatures:
        """Return power and lines of sweeps with start delays and amplitudes of measured ones, (copies x groups, ...).

        Harmonics multiply the jitter.
        """
        rows = part.steady.rows(np.tile(np.arange(len(part.groups)), copies))
        rows.sweep_id = np.arange(len(rows))
        delays = np.stack([self._start_delays(g, copies) for g in part.groups], axis=1)
        rows.start_delay += delays.ravel()
        amplitudes = np.stack([self._amplitudes(g, copies) for g in part.groups], axis=1)
        for number, heard in enumerate(self._recorded.heard):
            rows.stations[heard].received_power += amplitudes[..., number].ravel()
        align(part, rows, copies, self._recorded.sweeps, effects)
        return self._features(part, rows, effects, noise, harmonic, quiet=quiet, shape=False)

    def samples(self, part: Part, effects: Sequence[Effect], noise: bool) -> tuple[np.ndarray, ...]:
        """Return one sweep per group before the ADC, of each station with samples (G, N), with iq (G, 2 N) [LSB]."""
        rows = part.steady.rows(slice(None))
        samples = synthesise(rows, 0, effects, noise, False)
        return tuple(samples[i].reshape(len(rows), -1) for i in self._recorded.heard)

    def distorted(self, part: Part, effects: Sequence[Effect]) -> SweepFeatures:
        """Return means over noisy sweeps of `jittered`, with harmonics."""
        return _mean(self.jittered(part, effects, True, SIMULATION.distorted, harmonic=True), SIMULATION.distorted)

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
        samples = synthesise(rows, 0, effects, noise, False, copies)
        heard = tuple(samples[i].reshape(len(rows), -1) for i in self._recorded.heard)
        full_scale = rows.stations[self._recorded.heard[0]].full_scale
        return part.extract(heard, full_scale, rows.refractive_index, harmonic, quiet, noisy=False, shape=shape)

    def _times(self, group: int, count: int) -> np.ndarray:
        """Return times spread over a group's sweeps, from their mean [s] (count,)."""
        time = self._recorded.data.time[self._recorded.members[group]]
        return np.interp((np.arange(count) + 0.5) / count * len(time) - 0.5, np.arange(len(time)), time) - time.mean()

    def _amplitudes(self, group: int, count: int) -> np.ndarray:
        """Return the amplitudes minus the group's mean, of `count` of its sweeps (count, S) [dB]."""
        return _spread(self._recorded.sweeps[group].amplitude, count)

    def _start_delays(self, group: int, count: int) -> np.ndarray:
        """Return T_off minus the group's mean, of `count` of its sweeps [s]."""
        return _spread(self._recorded.sweeps[group].beat, count) / self._recorded.parts[0].extract.beat_per_start_delay


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
