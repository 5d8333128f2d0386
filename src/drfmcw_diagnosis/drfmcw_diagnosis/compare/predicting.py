"""The features that the simulator's forward model predicts for a recording's groups, with effects or without."""

import dataclasses
import functools
from collections.abc import Sequence

import numpy as np

from drfmcw_physics.constants import SPEED_OF_LIGHT
from drfmcw_sim.effects import ActsOn, Effect, Motion, Of, Stage
from drfmcw_sim.measurements import Measurements

from ..features.extractor import mean_power, quiet_sweeps, ramp_spectrum, unevenness
from .groups import Groups, Part, acted
from .noise_model import NoiseModel
from .recorded_sweeps import RecordedSweeps
from .simulated_sweeps import DISTORTED, SimulatedSweeps

_RAISED = 1.5  # of the noise, where the median around a bin counts as raised by lines
_BY_DISTANCE = (Stage.GEOMETRY, Stage.PATHS)  # stages of effects that may follow the distance
_BURSTING = 12  # sweeps simulated per group, at most, where one comes and goes


class Predictor:
    """Predicts the features of a recording's G groups; S stations with samples."""

    def __init__(self, recorded: RecordedSweeps, std: Groups) -> None:
        """Predict what there is without effects.

        Args:
            recorded: whose conditions, lines and jitter the model has.
            std: of the measured features, which tell the noise around lines and in the ramp.
        """
        self._recorded, self._std = recorded, std
        self._simulated = SimulatedSweeps(recorded)
        self.noise = NoiseModel(recorded, np.isfinite(std.coherence).any(axis=1))
        # what there is without any effect, and what noise makes of it, by the first group of a part
        self._plain_power: dict[int, np.ndarray] = {}
        self._undistorted: dict[int, tuple[np.ndarray, ...]] = {}
        self._steady: dict[int, tuple[np.ndarray, np.ndarray]] = {}
        # where the parts' groups and their sweeps stand, part after part
        group = np.concatenate([part.groups for part in recorded.parts])
        self._group_order = np.argsort(group)
        self._sweep_order = np.argsort(np.repeat(group, [len(recorded.members[g]) for g in group]), kind='stable')
        self.plain = self.predict(())

    def predict(self, effects: Sequence[Effect]) -> Groups:
        """Return the features that the model with `effects` predicts, from noise-free samples of the simulator."""
        return self._predict(tuple(effects))

    @functools.lru_cache(maxsize=64)  # noqa: B019 a predictor lives as long as its predictions are wanted
    def _predict(self, effects: tuple[Effect, ...]) -> Groups:
        found: list[Groups] = []
        for recorded in self._recorded.parts:
            part, reference = self._placed(recorded, effects)
            state = acted(part, effects)
            features = self._simulated.mean(part, [e for e in effects if not e.bursts])
            displacement = self._displacement(part, effects)
            quiet, shared = self.noise.predicted(part, state, effects, features.line)
            velocity = self._velocity(part.steady, effects)
            distorting = any(e.distorts for e in effects)
            if distorting:
                changed, harmonic, piled = self._distortion(part, effects)
                harmonic = self.plain.harmonic[part.groups] + harmonic
            else:
                harmonic = self.plain.harmonic[part.groups] if effects else features.harmonic
                piled = np.zeros((len(part.groups), len(self._recorded.heard)))
            burst = np.zeros((len(part.groups), len(self._recorded.heard), 3))
            if any(e.bursts for e in effects):
                burst, louder = self._bursts(part, effects)
                quiet = quiet + louder
            if not effects:
                self._plain_power[int(part.groups[0])] = features.power
            added = np.maximum(features.power - self._plain_power[int(part.groups[0])], 0.0).astype(float)
            added[self._recorded.bands.at_line(features.line, added.shape[-1])] = 0.0
            noise, floor = self._recorded.bands.raised(quiet, added, features.line)
            around, steady = np.ones(added.shape), self._std.lines[part.groups]
            if distorting:
                noise = self.plain.noise[part.groups] + changed
                # where harmonics raise the median around, the noise itself is what they add to
                raised = (steady > _RAISED * floor) & np.any(added > floor, axis=-1, keepdims=True)
                around[raised] = (floor / steady)[raised]
            found.append(
                Groups(
                    ramp_spectrum(features.ramp),
                    np.ones((len(part.groups), *self._std.flutter.shape[1:])),
                    around + added / steady,
                    features.mean,
                    harmonic,
                    piled,
                    burst,
                    noise,
                    shared,
                    features.beat,
                    features.amplitude,
                    features.range - reference,
                    velocity,
                    displacement,
                )
            )
        return self._joined(found)

    def _joined(self, found: Sequence[Groups]) -> Groups:
        """Return the features of the parts' groups as those of all groups in their order."""
        values = {f.name: np.concatenate([getattr(g, f.name) for g in found]) for f in dataclasses.fields(Groups)}
        movement = values.pop('movement')[self._sweep_order]
        return Groups(**{name: each[self._group_order] for name, each in values.items()}, movement=movement)

    def changing(self, effects: Sequence[Effect]) -> np.ndarray:
        """Return by how much the ramp changes with the phase of each sweep, over the noise of one sweep (G, 2 S, K).

        What a spur or a mirror line brings has a phase of its own in every sweep.
        """
        result = np.zeros(self._std.flutter.shape)
        for part in self._recorded.parts:
            ramp = ramp_spectrum(self._simulated.copies(part, [e for e in effects if not e.bursts], 2)[0].ramp)
            result[part.groups] = ramp.reshape(2, -1, *ramp.shape[1:]).var(axis=0, ddof=1)
        return result / self._std.flutter

    def _distortion(self, part: Part, effects: Sequence[Effect]) -> tuple[np.ndarray, ...]:
        """Return by how much distortion changes noise in bands (G, S, BANDS) [dB], harmonics (G, S, 2 H), piles (G, S).

        A limiter holds noise down, and noise carries a line across the limit that it does not reach by itself: sweeps
        are simulated with noise, and with the same noise without the distortion.
        """
        first = int(part.groups[0])
        if first not in self._undistorted:
            self._undistorted[first] = self._noisy(part, ())
        pairs = zip(self._noisy(part, effects), self._undistorted[first], strict=True)
        noise, harmonic, piled = (after - before for after, before in pairs)
        return np.nan_to_num(noise), harmonic, piled

    def _noisy(self, part: Part, effects: Sequence[Effect]) -> tuple[np.ndarray, ...]:
        """Return of noisy sweeps the noise in bands [dB of 1 LSB^2 per sample], harmonics, and samples piled up."""
        features = self._simulated.distorted(part, effects, True)
        counts = np.full(len(self._recorded.heard), DISTORTED)
        pairs = zip(features.power, features.line, strict=True)
        noise = np.array([self._recorded.bands.measured(*pair, counts)[0] for pair in pairs])
        return noise, features.harmonic, features.piled

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
        features = self._simulated.jittered(part, effects, True, copies)
        quiet, power = (x.reshape(copies, count, *x.shape[1:]).swapaxes(0, 1) for x in (features.quiet, features.power))
        line = features.line.reshape(copies, count, -1).mean(axis=0)
        spectra = [mean_power(p, quiet_sweeps(q)) for p, q in zip(power, quiet, strict=True)]
        bands = [self._recorded.bands.measured(p, at, n)[0] for (p, n), at in zip(spectra, line, strict=True)]
        return np.array([unevenness(q)[0] for q in quiet]), np.array(bands)

    def _placed(self, part: Part, effects: Sequence[Effect]) -> tuple[Part, np.ndarray]:
        """Return where the model has its groups, and what the reference says there (G,) [m].

        An error of the reference means that the target stands elsewhere. To first order that changes the range alone;
        but a reflection, told to a part of the carrier's wavelength, follows the true distance.
        """
        reading = self._reference(part, effects)
        error = reading - part.steady.range
        if not error.any() or not any(ActsOn.DELAY in e.acts_on and e.stage in _BY_DISTANCE for e in effects):
            return part, reading
        steady = part.steady.rows(slice(None))
        steady.range -= error
        steady.paths[0].delay -= error * steady.refractive_index / SPEED_OF_LIGHT
        return dataclasses.replace(part, steady=steady), part.steady.range

    def _reference(self, part: Part, effects: Sequence[Effect]) -> np.ndarray:
        """Return what the reference says in each group (G,) [m]; its errors move the model's distance the other way."""
        m = part.steady
        slope = np.where(self._recorded.standing, 0.0, self._recorded.slope)[part.groups]

        def distance_at(time):
            return m.range + slope * (time - m.time)

        reading = m.range.copy()
        for effect in effects:
            reading = reading + effect.reference_error(m.time, m.range, distance_at)
        return reading

    def _velocity(self, m: Measurements, effects: Sequence[Effect]) -> np.ndarray:
        """Return the slope that the reference shows in each group [m/s] (G,): it sees the crane drive, not sway."""
        driving = [effect for effect in effects if effect.motion is Motion.DRIVE]
        if not driving:
            return m.velocity
        driven = m.rows(slice(None))
        for effect in driving:
            effect.prepare(driven)
        return driven.velocity

    def _displacement(self, part: Part, effects: Sequence[Effect]) -> np.ndarray:
        """Return the movement within each group beyond what the reference shows [m], one group after another."""
        # geometry follows the distance, of which each sweep has a reading with noise but a standing crane has one
        moving = [e for e in effects if ActsOn.DELAY in e.acts_on and e.of is Of.PATH and e.stage != Stage.GEOMETRY]
        if not moving:
            return np.zeros(len(part.all))
        moved = part.all.rows(slice(None))
        for effect in moving:
            effect.prepare(moved)
        way = (moved.paths[0].delay - part.all.paths[0].delay) * SPEED_OF_LIGHT / part.all.refractive_index
        creep = (self._velocity(part.all, effects) - part.all.velocity) * part.all.time
        creeps = self._recorded.standing[part.groups]  # slower than the reference could show
        ways = [way[local] + (creep[local] if slow else 0.0) for local, slow in zip(part.local, creeps, strict=True)]
        return np.concatenate([w - w.mean() for w in ways])
