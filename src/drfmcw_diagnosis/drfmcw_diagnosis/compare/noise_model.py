"""The noise that the model expects: floor and skirts in bands, and what both stations' lines have in common."""

from collections.abc import Callable, Sequence

import numpy as np
from scipy.special import exp1, ndtr

from drfmcw_node.estimators.noise import QUANTISATION
from drfmcw_physics.constants import DECIBELS_PER_NEPER
from drfmcw_physics.phase_noise import PhaseNoise, around_line, coherent_loss, combination_gain, variance_within
from drfmcw_sim.effects import Effect, Stage
from drfmcw_sim.measurements import Measurements, Station

from ..features import coherence
from ..features.limits import SIDEBANDS, SPECTRUM
from ..features.spectra import median_of_mean
from .groups import Part
from .limits import MODEL, SIMULATION
from .recorded_sweeps import RecordedSweeps


def _oscillators(state: Measurements) -> list[PhaseNoise]:
    """Return the phase noise of the stations of which it is known."""
    return [s.phase_noise for s in state.stations if s.phase_noise is not None]


class NoiseModel:
    """Noise of a recording's G groups, in closed form; S stations with samples."""

    def __init__(self, recorded: RecordedSweeps, shared: np.ndarray) -> None:
        """Remember whose noise it is.

        Args:
            recorded: sweeps whose lines have the skirts.
            shared: in which groups the coherence of both lines' noise is compared (G,).
        """
        self._topology, self._shared = recorded.topology, shared
        self._bins = recorded.sweeps[0].power.shape[-1]
        amplitude = np.array([sweeps.amplitude.mean(axis=0) for sweeps in recorded.sweeps])
        # of the lines (G, S), at each frequency of a line [LSB^2]
        self._powers = 10.0 ** (amplitude / 10.0) * self._topology.line_share
        self._counts = np.array(recorded.quiet_counts, float)  # sweeps whose spectra a mean has (G, S)
        self._lines = np.array([sweeps.line.mean(axis=0) for sweeps in recorded.sweeps])
        self._powers *= self._spread(recorded)
        # kept by what they depend on
        self._coherences: dict[tuple, np.ndarray] = {}
        self._bands: dict[tuple, np.ndarray] = {}

    def _spread(self, recorded: RecordedSweeps) -> np.ndarray:
        """Return the power of the lines with all that spreads them, over their coherent power (G, S).

        A curved ramp or a second path spreads a line over many bins; its skirts follow all of its power. Sweeps with
        bursts do not count, which are stronger than a line at times.
        """
        result = np.ones(self._powers.shape)
        width = recorded.sample_rate / 2 / (self._bins - 1)
        for part in recorded.parts:
            # of a line of unit power, summed over its bins
            summed = np.array(part.extract.window_power) * 2.0 * (self._bins - 1)
            for group in part.groups:
                for station, power in enumerate(recorded.spectra[group]):
                    at = round(self._lines[group, station] / width)
                    reach = SPECTRUM.line
                    low, high = max(at - reach, 0), min(at + reach + 1, self._bins)
                    around = np.concatenate([power[max(low - reach, 0) : low], power[high : high + reach]])
                    total = np.sum(power[low:high] - np.median(around)) / summed[station]
                    result[group, station] = max(total / self._powers[group, station], SPECTRUM.least_spread)
        return result

    def _around(self, oscillators: Sequence[PhaseNoise], rate: float) -> float:
        """Return the power that skirts add to the bins of a line, over its coherent power, and 1, see `_spread`."""
        if self._topology.hears_itself:
            return 1.0
        width, reach = rate / 2 / (self._bins - 1), SPECTRUM.line
        within = around_line(oscillators, width * np.arange(-reach, reach + 1), rate)
        beside = np.median(around_line(oscillators, width * np.arange(reach + 1, 2 * reach + 1), rate))
        return 1.0 + width * float(np.sum(within - beside))

    def predicted(
        self, part: Part, state: Measurements, effects: Sequence[Effect], line: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray]:
        """Return the noise of each group in bands [dB of 1 LSB^2 per sample] (G, S, N), and the coherence of both.

        Skirts go with the power that a line has, whatever made it.

        Args:
            part: groups of one setting.
            state: their conditions after effects.
            effects: of which filters pass noise by its frequency.
            line: of each station (G, S) [Hz].
        """
        line = SIMULATION.line_step * np.rint(line / SIMULATION.line_step)
        decisive = (
            int(part.groups[0]),
            *_oscillators(state),
            *(e for e in effects if e.stage == Stage.FILTER),
            *(s.noise_density.tobytes() for s in state.stations),
            np.rint(state.paths[0].delay / SIMULATION.delay_step).tobytes(),
        )
        if decisive not in self._coherences:
            self._coherences[decisive] = self._coherence(part, state, effects)
        of_lines = (*decisive, line.tobytes())
        if of_lines not in self._bands:
            self._bands[of_lines] = self._in_bands(part, state, effects, line)
        return self._bands[of_lines], self._coherences[decisive]

    def _in_bands(self, part: Part, state: Measurements, effects: Sequence[Effect], line: np.ndarray) -> np.ndarray:
        """Return the noise of each group in bands, as `predicted`."""
        rate = state.stations[0].sweep.sample_rate
        count = SPECTRUM.bands * SIMULATION.frequencies
        centre = (np.arange(count) + 0.5) * (rate / 2 / count)
        oscillators = _oscillators(state)
        filters = [self._filter(state.stations[i], state, effects) for i in self._topology.heard]
        own = line[..., None]
        offsets = np.stack([np.abs(centre - own), np.minimum(centre + own, rate - centre - own)])
        if not self._topology.has_mirror:  # all of the line at one frequency
            offsets = np.minimum(offsets[:1], rate - offsets[:1])
        if self._topology.hears_itself:  # the oscillator meets itself, a delay later
            density = sum((o.single_sideband(offsets) for o in oscillators), np.zeros_like(offsets))
            density = density * combination_gain(offsets, state.paths[0].delay[:, None, None])
        else:
            density = around_line(oscillators, offsets, rate)
        passed = np.array([np.abs(passes(centre)) ** 2 for passes in filters])
        # the line's own power has passed the filters already
        ahead = np.stack([np.abs(passes(at)) ** 2 for passes, at in zip(filters, line.T, strict=True)], axis=1)
        powers = self._powers[part.groups] / self._around(oscillators, rate)
        skirts = passed / ahead[..., None] * density.sum(axis=0) * rate * powers[..., None]
        floor = np.stack(
            [self._floor(state.stations[i], p[None]) for i, p in zip(self._topology.heard, passed, strict=True)], axis=1
        )
        width = rate / 2 / (self._bins - 1)
        kept = (SPECTRUM.edge * width <= centre) & (centre <= rate / 2 - SPECTRUM.edge * width)
        kept = kept & (np.abs(centre - own) >= SPECTRUM.line * width)  # a band that a line fills is not compared
        total = floor + np.where(kept, skirts, np.nan)
        bands = total.reshape(*line.shape, SPECTRUM.bands, SIMULATION.frequencies)
        noise: np.ndarray = 10.0 * np.log10(_median(bands, self._counts[part.groups][..., None]))
        return noise

    def loss(self, part: Part, state: Measurements) -> np.ndarray:
        """Return by how much phase noise lowers the power of each group's lines (G, 1) [dB].

        The level is that of the blocks of a sweep, which slower noise turns as a whole.

        Args:
            part: groups of one setting.
            state: their conditions after effects.
        """
        delay, own = state.paths[0].delay, self._topology.hears_itself
        block, rate = part.extract.estimator.block, part.extract.sweeps[0].sample_rate
        variances = (variance_within(o, block, rate, delay if own else None) for o in _oscillators(state))
        loss: np.ndarray = coherent_loss(sum(variances, np.zeros(len(part.groups))))[:, None]
        return loss

    def additive_std(self, part: Part, state: Measurements, effects: Sequence[Effect]) -> np.ndarray:
        """Return the standard deviation of each sample by additive noise, of I and Q apart (G, S) [LSB].

        Args:
            part: groups of one setting.
            state: their conditions after effects.
            effects: of which filters pass noise by its frequency.
        """
        frequency = np.linspace(0.0, state.stations[0].sweep.sample_rate / 2, self._bins)
        found = []
        for i in self._topology.heard:
            station = state.stations[i]
            passed = np.abs(self._filter(station, state, effects)(frequency)) ** 2
            found.append(np.sqrt(_thermal(station, passed.mean(keepdims=True))))
        return np.stack(found, axis=1)

    def rise(
        self, part: Part, state: Measurements, effects: Sequence[Effect], level: np.ndarray, line: np.ndarray
    ) -> np.ndarray:
        """Return by how much additive noise raises the level that lines show (G, S) [dB].

        The level is the mean of the log amplitudes of a sweep's blocks. Of a line of power P in noise of power N it is
        ln sqrt(P) + E1(P / N) / 2 in the mean, for the amplitude has Rice's distribution.

        Args:
            part: groups of one setting.
            state: their conditions after effects.
            effects: of which filters pass noise by its frequency.
            level: of lines without noise (G, S) [dB of 1 LSB].
            line: their frequencies (G, S) [Hz].
        """
        floors = []
        for i, at in zip(self._topology.heard, line.T, strict=True):
            station = state.stations[i]
            passed = np.abs(self._filter(station, state, effects)(at)) ** 2
            floors.append(self._floor(station, passed))
        power = part.extract.estimator.block * 10.0 ** (level / 10.0) * self._topology.line_share
        rise: np.ndarray = DECIBELS_PER_NEPER * exp1(power / np.stack(floors, axis=1)) / 2.0
        return rise

    def limit(self, part: Part, noise: np.ndarray) -> np.ndarray:
        """Return to what the noise in bands is trusted (G, S, N) [dB]: less where a skirt rules.

        Args:
            part: groups of one setting.
            noise: of these without effects (G, S, N) [dB of 1 LSB^2 per sample].
        """
        limit: np.ndarray = MODEL.floor + MODEL.skirt * self.skirt_share(part, noise)
        return limit

    def skirt_share(self, part: Part, noise: np.ndarray) -> np.ndarray:
        """Return the share of the oscillators' skirts in the noise in bands (G, S, N); arguments as `limit`."""
        floor = np.stack([self._floor(part.steady.stations[i], np.ones((1, 1))) for i in self._topology.heard], axis=1)
        share: np.ndarray = np.clip(1.0 - floor / 10.0 ** (noise / 10.0), 0.0, 1.0)
        return share

    def _coherence(self, part: Part, state: Measurements, effects: Sequence[Effect]) -> np.ndarray:
        """Return the coherence of both lines' phase noise in each group (G, C); zero where it is not compared.

        Args:
            part: groups of one setting.
            state: their conditions after effects.
            effects: of which filters pass sidebands by their frequency.
        """
        result = np.zeros((len(part.groups), SIDEBANDS.bands))
        if not self._shared[part.groups].any():
            return result
        rate = state.stations[0].sweep.sample_rate
        oscillators = _oscillators(state)  # known of both
        lines, powers = self._lines[part.groups], self._powers[part.groups] / self._around(oscillators, rate)
        used = coherence.sidebands(lines, state.stations[0].sweep)
        at = lines[..., None, None]  # (G, 2, sidebands, offsets)
        sides = np.clip(at + np.stack([used.offset, -used.offset]), 0.0, rate / 2)
        filters = [self._filter(s, state, effects) for s in state.stations]
        responses = np.stack([passes(sides[:, i]) / passes(at[:, i]) for i, passes in enumerate(filters)], axis=1)
        floors = np.stack(
            [
                self._floor(s, np.abs(passes(sides[:, i])) ** 2)
                for i, (s, passes) in enumerate(zip(state.stations, filters, strict=True))
            ],
            axis=1,
        )
        # what the mirror lines' skirts bring there has a phase of its own
        mirrors = around_line(oscillators, at + sides, rate)
        floors = floors / (rate * powers[..., None, None]) + mirrors * np.abs(responses) ** 2
        sweeps = [s.sweep for s in state.stations]
        return coherence.predicted(used, oscillators, sweeps, floors, responses, state.paths[0].delay)

    def _filter(
        self, station: Station, state: Measurements, effects: Sequence[Effect]
    ) -> Callable[[np.ndarray], np.ndarray]:
        """Return a function: by how much the filters among `effects` pass frequencies (...) of a station's IF."""
        filters = [e for e in effects if e.stage == Stage.FILTER and e.applies_to(station.name)]
        if not filters:
            return np.ones_like
        one = state.rows(slice(0, 1))
        count = station.sweep.sample_count
        impulse = np.zeros((1, count, 2) if self._topology.iq else (1, count), np.float32)
        impulse[0, count // 2] = 1.0  # a cut at the Nyquist frequency rings both ways
        for effect in filters:
            effect.receive(impulse, next(s for s in one.stations if s.name == station.name), one, list)
        spectrum = np.fft.rfft(impulse[..., 0] if self._topology.iq else impulse, axis=1)[0]
        spectrum *= np.exp(2j * np.pi * (count // 2) / count * np.arange(len(spectrum)))  # time counts from the impulse
        frequency = np.arange(len(spectrum)) * station.sweep.sample_rate / count
        return lambda at: np.interp(at, frequency, spectrum)

    def _floor(self, station: Station, passed: np.ndarray) -> np.ndarray:
        """Return the variance of a sample without skirts (n, ...) [LSB^2], of both of its parts with iq.

        Args:
            station: n sweeps of it.
            passed: share of the noise ahead of them that filters leave (n, ...), or (1, ...) where all are alike.
        """
        return (_thermal(station, passed) + QUANTISATION) * float(self._topology.parts)


def _thermal(station: Station, passed: np.ndarray) -> np.ndarray:
    """Return the variance of a sample by additive noise, of I and Q apart (n, ...) [LSB^2]; arguments as `_floor`."""
    if station.noise_behind:
        passed = np.ones_like(passed)
    variance: np.ndarray = (station.noise_std() ** 2 * passed.T).T
    return variance


def _median(values: np.ndarray, count: np.ndarray) -> np.ndarray:
    """Return what the median of a band shows whose bins scatter about their expectations, NaN where nothing is.

    The mean of `count` exponential powers is, to the power of a third, nearly normal (Wilson, Hilferty 1931). Where
    the expectation varies over the band, the median over bins is not that of the expectations.

    Args:
        values: expected power over the frequency (..., F), NaN where there is none.
        count: of powers in the mean of each bin (...), at least 1.
    """
    used = ~np.isnan(values)
    root = np.cbrt(np.where(used, values, 1.0))
    middle = np.cbrt(median_of_mean(count))[..., None]
    sharpness = 3.0 * np.sqrt(count)[..., None]
    low = np.min(root, axis=-1, where=used, initial=np.inf)
    high = np.max(root, axis=-1, where=used, initial=0.0)
    half = 0.5 * np.count_nonzero(used, axis=-1)
    empty = half == 0.0
    low[empty] = high[empty]
    for _ in range(SIMULATION.halvings):
        tried = 0.5 * (low + high)
        below = np.sum(ndtr(sharpness * middle * (tried[..., None] / root - 1.0)), axis=-1, where=used) < half
        low, high = np.where(below, tried, low), np.where(below, high, tried)
    return np.where(empty, np.nan, (0.5 * (low + high)) ** 3)
