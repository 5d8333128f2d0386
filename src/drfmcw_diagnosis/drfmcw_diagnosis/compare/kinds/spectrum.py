"""What else is in the IF: narrow lines, the mean of the samples over the sweep, and when the signal begins and ends."""

import dataclasses
from collections.abc import Callable

import numpy as np
from scipy.ndimage import maximum_filter1d

from drfmcw_physics.sweep import SweepSettings

from ...features import signal_ends, transient
from ...features.extractor import span_times
from ...features.limits import SPECTRUM
from ...features.spectra import gaussian
from ..groups import variance_factor
from ..limits import MODEL, SCATTER, SIMULATION
from ..measuring import Evidence
from ..predicting import Expected
from ..recorded_sweeps import RecordedSweeps
from .explained import Explained
from .kind import Kind, Measured, Plotted, Shown, Trust, at_distance


@dataclasses.dataclass(frozen=True, kw_only=True)
class Lines(Kind):
    """Power in each bin over the noise around it (G, S, B), 1 for noise alone.

    Its standard deviation stands for the noise around it [LSB^2].
    """

    def measured(self, evidence: Evidence) -> Measured:
        """Return mean spectra of sweeps without bursts over the noise around, and that noise."""
        return np.stack(evidence.recorded.spectra) / evidence.around, evidence.around

    def predicted(self, expected: Expected) -> np.ndarray:
        """Return what simulated sweeps add to the power, over the measured noise around."""
        around, steady = np.ones(expected.added.shape), expected.std[self.name][expected.part.groups]
        if expected.distorting:
            # where harmonics raise the median around, the noise itself is what they add to
            _, floor = expected.raised
            raised = (steady > SIMULATION.raised * floor) & np.any(expected.added > floor, axis=-1, keepdims=True)
            around[raised] = (floor / steady)[raised]
        return around + expected.added / steady

    def whitened(self, values: np.ndarray, plain: np.ndarray, std: np.ndarray, recorded: RecordedSweeps) -> np.ndarray:
        """Return means of exponential powers as standard normals, beside the stations' own lines."""
        quiet = recorded.quiet_counts[..., None]
        return np.where(recorded.beside_lines, gaussian(values, quiet) - gaussian(np.ones(1), quiet), 0.0)

    def uncertain(self, explained: Explained, size: np.ndarray) -> np.ndarray:
        """Let harmonics be displaced: their frequency is a multiple of the line's, which is uncertain."""
        if not explained.distorting:
            return size
        bins = explained.recorded.beside_lines.shape[-1]
        displaced: np.ndarray = maximum_filter1d(size.reshape(-1, bins), MODEL.harmonics_width, axis=1)
        return displaced.ravel()

    def profile(self, recorded: RecordedSweeps, z: np.ndarray, positions: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Return squares over the IF [Hz]."""
        bins = z.reshape(len(recorded.members), -1)
        return _frequencies(recorded, bins.shape[1]), np.sum(bins**2, axis=0)

    def plotted(self, shown: Shown) -> Plotted:
        """Return whitened powers over the IF [Hz]."""
        count = len(shown.whitened)
        x = _frequencies(shown.recorded, count)
        return Plotted(x, shown.whitened, np.ones(count), shown.template, 'σ', at_distance(shown))


@dataclasses.dataclass(frozen=True, kw_only=True)
class Mean(Kind):
    """Mean of the samples (G, S, Q) [LSB], of I and Q apart."""

    def measured(self, evidence: Evidence) -> Measured:
        """Return the mean over each group."""
        return _averaged(evidence, self.name)

    def predicted(self, expected: Expected) -> np.ndarray:
        """Return the mean of simulated sweeps."""
        return expected.features.mean

    def profile(self, recorded: RecordedSweeps, z: np.ndarray, positions: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Return all squares at 0 Hz."""
        return np.zeros(1), np.array([float(z @ z)])


@dataclasses.dataclass(frozen=True, kw_only=True)
class _InSpans(Kind):
    """Numbers in V spans of the sweep (G, S, 2 V) or (G, S, V): those of one part of the samples after the other's."""

    times: Callable[[SweepSettings], np.ndarray]  # when the spans of a sweep begin and end (V, 2) [s]
    level: str = 'if_samples'
    axis: str = 'ramp_time'
    averages: bool = True
    scatter_freedom: int = 1

    def _spans(self, recorded: RecordedSweeps) -> np.ndarray:
        """Return when each span of the first station's sweep begins and ends (V, 2) [s]."""
        return self.times(recorded.data.sweeps[0][recorded.heard[0]])

    def _turns(self, recorded: RecordedSweeps, parts: int) -> np.ndarray:
        """Return how many periods each line has in each span, of so many parts (G, S, V parts)."""
        line = np.stack([s.line.mean(axis=0) for s in recorded.sweeps])
        return line[..., None] * np.tile(np.diff(self._spans(recorded))[:, 0], parts)

    def profile(self, recorded: RecordedSweeps, z: np.ndarray, positions: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Return squares over the time in the sweep [s]."""
        middle = self._spans(recorded).mean(axis=1)
        return middle, np.sum(z.reshape(-1, len(middle)) ** 2, axis=0)

    def plotted(self, shown: Shown) -> Plotted:
        """Return the numbers of the first part, I or real, over the time in the sweep [s]."""
        middle = self._spans(shown.recorded).mean(axis=1)
        at = shown.group, shown.row, slice(len(middle))
        values = (shown.residual[at], shown.std[at], shown.curve[at])
        return Plotted(middle, *values, self.unit, at_distance(shown))


@dataclasses.dataclass(frozen=True, kw_only=True)
class Baseline(_InSpans):
    """Means of the samples in spans of the sweep less the mean of these (G, S, Q V) [LSB]."""

    def measured(self, evidence: Evidence) -> Measured:
        """Return the mean over each group, of stations whose line the spans' windows keep out."""
        values, std = _averaged(evidence, self.name)
        turns = self._turns(evidence.recorded, evidence.recorded.topology.parts)
        return values, np.where(turns > SPECTRUM.kept_out, std, np.inf)

    def predicted(self, expected: Expected) -> np.ndarray:
        """Return what effects add: lines, which have a random phase in each sweep, leave nothing in the mean."""
        if expected.plain is expected:
            return np.zeros(expected.features.baseline.shape)
        return expected.features.baseline - expected.plain.features.baseline


@dataclasses.dataclass(frozen=True, kw_only=True)
class Transient(_InSpans):
    """Means of the samples after the signal's begin, over the line and at its phase (G, S, 2 V), real parts first."""

    def measured(self, evidence: Evidence) -> Measured:
        """Return the mean over each group, of spans long enough."""
        values, std = _at_phase(evidence, self.name, SCATTER.least_transient)
        return values, np.where(np.abs(self._turns(evidence.recorded, 2)) > SPECTRUM.transient_turns, std, np.inf)

    def predicted(self, expected: Expected) -> np.ndarray:
        """Return the means of simulated sweeps."""
        return expected.features.transient


@dataclasses.dataclass(frozen=True, kw_only=True)
class Onset(_InSpans):
    """Change of the line in spans ahead of the window, over the line after them (G, S, 2 V), real parts first."""

    def measured(self, evidence: Evidence) -> Measured:
        """Return the mean over each group, of spans throughout which there is a signal.

        Where there is none in a part of a span, the signal's begin shows that.
        """
        values, std = _at_phase(evidence, self.name, 0.0)
        return values, np.where(_is_whole(values), np.hypot(std, SCATTER.least_onset), np.inf)

    def predicted(self, expected: Expected) -> np.ndarray:
        """Return the change in simulated sweeps; what takes a part of the signal shows in its begin alone."""
        found = expected.features.onset
        if expected.plain is expected:
            return found
        return np.where(_is_whole(found), found, expected.plain.features.onset)

    def limited(self, std: np.ndarray, expected: list[Expected]) -> np.ndarray:
        """Return the standard deviations, infinite where the nominal signal has not begun well ahead of a span."""
        std = std.copy()
        for one in expected:
            part = one.part
            for row, heard in enumerate(one.model.recorded.heard):
                begins = signal_ends.onset_spans(part.extract.sweeps[heard])[:, 0]
                late = one.features.ends[:, row, :1] + SPECTRUM.onset_late > begins
                std[part.groups, row] = np.where(np.tile(late | (begins < 0), 2), np.inf, std[part.groups, row])
        return std


@dataclasses.dataclass(frozen=True, kw_only=True)
class Ends(Kind):
    """Samples before the signal begins and before it ends (G, S, 2)."""

    def measured(self, evidence: Evidence) -> Measured:
        """Return the mean over each group; nothing of a station that hears itself, whose line has one phase throughout.

        Then the line's image, which random phases average out, moves the ends.
        """
        values, std = _averaged(evidence, self.name)
        if evidence.recorded.topology.hears_itself:
            return values, np.full_like(std, np.inf)
        return values, np.hypot(std, SCATTER.least_end)

    def predicted(self, expected: Expected) -> np.ndarray:
        """Return when the signals of simulated sweeps begin and end."""
        return expected.features.ends

    def profile(self, recorded: RecordedSweeps, z: np.ndarray, positions: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Return squares over the time in the sweep [s]."""
        window = recorded.data.sweeps[0][recorded.heard[0]].analysis_window()
        return np.array(window), np.sum(z.reshape(-1, 2) ** 2, axis=0)


def _is_whole(change: np.ndarray) -> np.ndarray:
    """Return whether there is a signal throughout spans, by the line's change there (..., 2 V), likewise."""
    real, imaginary = np.split(change, 2, axis=-1)
    return np.tile(np.abs(np.hypot(1.0 + real, imaginary) - 1.0) < SPECTRUM.onset_whole, 2)


def _at_phase(evidence: Evidence, feature: str, least: float) -> Measured:
    """Return means over each group of what counts at the line's phase, and deviations by the scatter, at least `least`.

    Infinite ones of a station that hears itself: its line has one phase throughout, so that others do not average out.
    Nor are sweeps compared that are too few to scatter.
    """
    recorded, values = evidence.recorded, evidence.mean(feature)
    if recorded.topology.hears_itself or not recorded.scatters:
        return values, np.full_like(values, np.inf)
    return values, _scatter(evidence, feature, least)


def _averaged(evidence: Evidence, feature: str) -> Measured:
    """Return means over each group of a feature, and their standard deviations: by the scatter, or by white noise."""
    if evidence.recorded.scatters:
        return evidence.mean(feature), _scatter(evidence, feature, SCATTER.least_mean)
    variance = np.stack([white[feature] for white in evidence.white])
    return evidence.mean(feature), np.maximum(np.sqrt(variance), SCATTER.least_mean) / evidence.roots[:, None, None]


def _scatter(evidence: Evidence, feature: str, least: float) -> np.ndarray:
    """Return the standard deviation of a feature's mean over each group, by its scatter; `least` is a sweep's."""
    each = [getattr(s, feature) for s in evidence.recorded.sweeps]
    variance = np.stack([x.var(axis=0, ddof=1) * variance_factor(len(x) - 1) for x in each])
    std: np.ndarray = np.maximum(np.sqrt(variance), least) / evidence.roots[:, None, None]
    return std


def _frequencies(recorded: RecordedSweeps, bins: int) -> np.ndarray:
    """Return the frequency of each bin of a spectrum (bins,) [Hz]."""
    return np.arange(bins) * (recorded.sample_rate / 2 / (bins - 1))


LINES = Lines(
    name='lines',
    of_converter=True,
    level='if_spectrum',
    axis='if_frequency',
    label='narrow lines in the IF spectrum',
    trust=Trust(usual=MODEL.lines, beside_distortion=MODEL.harmonics),
    averages=True,
    sparse=True,
    correlated=1.9,  # neighbouring bins of a Hann window share their noise
)
MEAN = Mean(
    name='mean',
    of_converter=True,
    level='if_spectrum',
    axis='if_frequency',
    label='mean of the samples',
    unit='LSB',
    averages=True,
    scatter_freedom=1,
)
BASELINE = Baseline(
    name='baseline',
    times=span_times,
    of_converter=True,
    label='mean of the samples over the ramp',
    unit='LSB',
)
TRANSIENT = Transient(
    name='transient',
    times=transient.times,
    label='what fades after the begin of the signal',
    of_begin=True,
)
ONSET = Onset(
    name='onset',
    times=signal_ends.onset_times,
    label='begin of the line',
    of_begin=True,
)
ENDS = Ends(
    name='ends',
    level='if_samples',
    axis='ramp_time',
    label='begin and end of the signal',
    unit='samples',
    rounded=True,
)
