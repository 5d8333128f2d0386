"""Noise: its level in bands, how unevenly it comes, and what both stations' lines share of it."""

import dataclasses

import numpy as np

from ...features.limits import SIDEBANDS, SURGES
from ...features.surges import NUMBERS, Steady, steady, unevenness
from ..groups import Part, pooled
from ..limits import MODEL
from ..measuring import Evidence
from ..predicting import Expected
from ..recorded_sweeps import RecordedSweeps
from .explained import Explained
from .kind import Kind, Measured, Of, Plotted, Shown, Trust, at_distance


@dataclasses.dataclass(frozen=True, kw_only=True)
class Burst(Kind):
    """How unevenly the power beside the line is spread (G, S, NUMBERS), see `features.surges.unevenness`.

    Bursts come whatever the distance, and a group holds a few of them by chance. So all groups of a setting have one
    set of numbers, which stands at the first of them, and settings are compared together.
    """

    def measured(self, evidence: Evidence) -> Measured:
        """Return the unevenness of all sweeps; nothing is compared where groups are too small to scatter.

        Bursts may be why sweeps were left out, so groups that are whole say how often they come. A setting without any
        says nothing, unless no setting has one.
        """
        recorded, sweeps = evidence.recorded, evidence.recorded.sweeps
        shape = (len(sweeps), len(recorded.heard), NUMBERS)
        values, std = np.zeros(shape), np.full(shape, np.inf)
        counted = recorded.whole | (not recorded.whole.any())
        for part in recorded.parts if recorded.scatters else ():
            whole = [sweeps[g] for g in part.groups if counted[g]]
            if not whole:
                continue
            count, first = sum(len(s.line) for s in whole), int(part.groups[0])
            for i in range(shape[1]):
                values[first, i], std[first, i, 0] = unevenness(
                    [s.quiet[:, i] for s in whole], [s.surge[:, i] for s in whole]
                )
                steady = _steady(part, i)
                if steady is not None:
                    std[first, i, 1:] = steady.std * SURGES.uncertain * np.sqrt(1.0 / count + 1.0 / steady.count)
        return values, std

    def predicted(self, expected: Expected) -> np.ndarray:
        """Return the unevenness of steady noise and what bursts add to it."""
        values = np.zeros((*expected.features.line.shape, NUMBERS))
        for i in range(values.shape[1]):
            steady = _steady(expected.part, i)
            values[:, i, 1:] = steady.mean if steady is not None else 0.0
        if expected.bursting:
            values[0] += expected.bursts.uneven
        return values

    def whitened(self, values: np.ndarray, plain: np.ndarray, std: np.ndarray, recorded: RecordedSweeps) -> np.ndarray:
        """Return numbers of all settings beyond those of steady noise, at the first, as uncorrelated normals."""
        over, weight = (values - plain) / std, 1.0 / std
        first = [int(part.groups[0]) for part in recorded.parts]
        together = np.sum((over * weight)[first], axis=0) / np.maximum(
            np.sqrt(np.sum(weight[first] ** 2, axis=0)), np.finfo(float).tiny
        )
        over[:] = 0.0
        for i, numbers in enumerate(together):
            steady = _steady(recorded.parts[0], i)
            if steady is not None:
                numbers[1:] = steady.apart @ numbers[1:]
            over[first[0], i] = numbers
        return over

    def by_chance(self, added: np.ndarray, std: np.ndarray) -> np.ndarray:
        """Return how far what bursts add is off by chance: which bursts there are differs in every number."""
        return super().by_chance(_with_usual(added.reshape(-1, NUMBERS)), std)

    def doubt(self, explained: Explained, template: np.ndarray, nonlinear: np.ndarray) -> np.ndarray:
        """Doubt what a distortion makes uneven: harmonics of strong sweeps come and go as bursts do."""
        doubt = super().doubt(explained, template, nonlinear)
        if explained.distorting:
            added, std = explained.uneven(), explained.std[self.name]
            numbers = self.whitened(added, np.zeros_like(added), std, explained.recorded).reshape(-1, NUMBERS)
            doubt = np.maximum(doubt, MODEL.uneven * _with_usual(numbers))
        return doubt

    def profile(self, recorded: RecordedSweeps, z: np.ndarray, positions: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Return squares over the distance, the same at all."""
        at, squares = super().profile(recorded, z, positions)
        return at, np.full(len(squares), squares.mean())

    def plotted(self, shown: Shown) -> Plotted:
        """Return by how much the power rises in sweeps, over the length of windows [samples]."""
        rise = slice(1, 1 + len(SURGES.windows))
        residual, std, curve = (shown.of_row(v)[shown.group, rise] for v in (shown.residual, shown.std, shown.curve))
        known = np.isfinite(std)
        x = np.array(SURGES.windows, float)
        return Plotted(x[known], residual[known], std[known], curve[known], self.unit)


def _with_usual(numbers: np.ndarray) -> np.ndarray:
    """Return sizes of rows of numbers (rows, K), none but the first below the usual one of its row (rows K,).

    The first, of the power itself, may be far larger than the others, which say how often it rises.
    """
    sizes = np.abs(numbers)
    sizes[:, 1:] = np.hypot(sizes[:, 1:], np.sqrt(np.mean(sizes[:, 1:] ** 2, axis=1, keepdims=True)))
    return sizes.ravel()


def _steady(part: Part, station: int) -> Steady | None:
    """Return what steady noise makes of the scores of a station with samples."""
    extract = part.extract
    return steady(extract.sweeps[extract.topology.heard[station]], extract.topology.iq)


@dataclasses.dataclass(frozen=True, kw_only=True)
class _InBands(Kind):
    """Numbers in bands of equal width, over the frequency [Hz]."""

    widest: float = 0.5  # upper end of the last band, of the sample rate

    def profile(self, recorded: RecordedSweeps, z: np.ndarray, positions: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Return squares over the frequency [Hz]."""
        bands = z.reshape(len(recorded.members), -1)
        return self._centres(recorded, bands.shape[1]), np.sum(bands**2, axis=0)

    def plotted(self, shown: Shown) -> Plotted:
        """Return the numbers over the frequency [Hz]."""
        residual, std, curve = (shown.of_row(v)[shown.group] for v in (shown.residual, shown.std, shown.curve))
        x = self._centres(shown.recorded, len(residual))
        known = np.isfinite(residual) & np.isfinite(std)
        return Plotted(x[known], residual[known], std[known], curve[known], self.unit, at_distance(shown))

    def _centres(self, recorded: RecordedSweeps, bands: int) -> np.ndarray:
        """Return the middle of each band (bands,) [Hz]."""
        return (np.arange(bands) + 0.5) * (recorded.sample_rate * self.widest / bands)


@dataclasses.dataclass(frozen=True, kw_only=True)
class Noise(_InBands):
    """Power of the spectrum in bands without lines (G, S, N) [dB of 1 LSB^2 per sample]."""

    def measured(self, evidence: Evidence) -> Measured:
        """Return medians over each band; not compared where the calibrations do not say what to expect."""
        noise, std = evidence.noise
        return noise, np.where(evidence.known.noise()[:, None], std, np.inf)

    def predicted(self, expected: Expected) -> np.ndarray:
        """Return floor and skirts, raised by further lines; a distortion acts on noise and line together."""
        if expected.distorting:
            changed: np.ndarray = expected.undistorted.raised[0] + expected.distortion.noise
            return changed
        return expected.raised[0]

    def limited(self, std: np.ndarray, expected: list[Expected]) -> np.ndarray:
        """Return standard deviations that include what floor and skirts are trusted to."""
        limit = np.empty(std.shape)
        for one in expected:
            limit[one.part.groups] = one.model.noise.limit(one.part, one.raised[0])
        return np.hypot(std, limit)

    def common_errors(self, std: np.ndarray, expected: list[Expected]) -> list[np.ndarray]:
        """Return errors of each station's floor, and of level and tilt of its skirts, alike in all groups."""
        share = np.empty(std.shape)
        for one in expected:
            share[one.part.groups] = one.model.noise.skirt_share(one.part, one.raised[0])
        tilt = np.linspace(-1.0, 1.0, std.shape[-1])
        found = []
        for station in range(std.shape[1]):
            chosen = np.zeros(std.shape)
            chosen[:, station] = 1.0
            floor, skirt = MODEL.common_floor * (1.0 - share), MODEL.common_skirt * share
            found += [chosen * floor, chosen * skirt, chosen * skirt * tilt]
        return found

    def doubt(self, explained: Explained, template: np.ndarray, nonlinear: np.ndarray) -> np.ndarray:
        """Doubt what a distortion takes of it: few sweeps have some phases by chance."""
        doubt = super().doubt(explained, template, nonlinear)
        if explained.distorting:
            scattering = explained.scattering() / explained.std[self.name]
            doubt = np.hypot(doubt, np.nan_to_num(scattering).ravel())  # a line may fill a band
        return doubt


@dataclasses.dataclass(frozen=True, kw_only=True)
class Coherence(_InBands):
    """What the phase noise of both lines has in common (G, C), see `features.coherence`."""

    of: Of = Of.PATH

    def measured(self, evidence: Evidence) -> Measured:
        """Return the mean of the sweeps' shares."""
        shares = evidence.recorded.shares
        values = np.stack([share.mean(axis=0) for share in shares])
        return values, _scatter(evidence) / np.sqrt([len(share) for share in shares])[:, None]

    def predicted(self, expected: Expected) -> np.ndarray:
        """Return what oscillators and floors make of it."""
        return expected.noise[1]

    def uncertain(self, explained: Explained, size: np.ndarray) -> np.ndarray:
        """Doubt it further beside effects that make the noise of both stations run apart."""
        return size + explained.incoherence / explained.trust


def _scatter(evidence: Evidence) -> np.ndarray:
    """Return by what shares in the coherence scatter from sweep to sweep (G, C); inf where not compared."""
    recorded = evidence.recorded
    counts = np.array([len(share) for share in recorded.shares])
    if not (recorded.scatters and recorded.topology.both_heard and evidence.known.noise().all()):
        return np.full((len(counts), SIDEBANDS.bands), np.inf)
    # each share is relative to the mean of both lines' noise, which takes one more degree of freedom
    scatter = pooled(recorded.shares) * np.sqrt((counts - 1.0) / (counts - 2.0))[:, None]
    present = np.array([np.any(s != 0.0, axis=0) for s in recorded.shares])
    limit = MODEL.coherence * np.sqrt(counts)[:, None]
    return np.where(present, np.hypot(scatter, limit), np.inf)


BURST = Burst(
    name='burst',
    of_all=True,
    level='noise',
    axis='range',
    label='bursts of noise',
    trust=Trust(beside_bursts=MODEL.all_bursts),
)
NOISE = Noise(
    name='noise',
    of_converter=True,
    level='noise',
    axis='if_frequency',
    label='noise',
    unit='dB',
    has_gaps=True,
    divisible=True,
    trust=Trust(beside_distortion=MODEL.harmonics, beside_bursts=MODEL.bursts, rest_beside_bursts=MODEL.bursts_rest),
    needs_conditions=True,
)
COHERENCE = Coherence(
    name='coherence',
    level='noise',
    axis='if_frequency',
    label='noise that both lines share',
    rests_on=NOISE.name,
    widest=SIDEBANDS.farthest,
    trust=Trust(usual=MODEL.coherence_added),
)
