"""Lines of one or several stations in blocks of a sweep.

Each sweep is demodulated near its line and averaged over blocks of about 15 us. Mirror line and constant are subtracted
from each block, using the line that a first round finds.
"""

import dataclasses
from collections.abc import Sequence

import numpy as np

from drfmcw_physics.oscillators import Calibration
from drfmcw_physics.sweep import SweepSettings

from .estimation import Estimates, EstimatorSettings, Sweeps
from .maximum_likelihood import FINE, MaximumLikelihoodEstimator
from .tones import chirp_of, is_steady, mean_turn, rotation, tone, total_power

BLOCKS = range(24, 41)
"""Lengths of a block that are tried [samples]."""

_CLEAR = 0.7  # share of the blocks' power in their tone, above which the chirp is beyond doubt
_ROUNDS = 3  # of mirror line and constant against a line whose chirp is not known


@dataclasses.dataclass(frozen=True)
class Basebands:
    """Lines in blocks of a sweep, demodulated, of S stations."""

    lines: np.ndarray  # (S, B, K) complex64 [LSB]: a of a line a exp(j psi) + conj, at the block's centre
    frequency: np.ndarray  # of the demodulation (S, B) [Hz]
    time: np.ndarray  # of the blocks (S, K), since the station's own sweep start [s]
    power: tuple[np.ndarray, ...]  # squared magnitude of the Hann-windowed sweep's bins, of each station (B, bins)
    beat: np.ndarray  # frequency of each line (S, B) [Hz]


@dataclasses.dataclass(frozen=True)
class _Demodulated:
    """The stations' sweeps times exp(-j psi), in blocks."""

    line: np.ndarray  # (S, B, K) complex64 [LSB]: a of a line a exp(j psi) + conj, mirror line and constant leaking in
    mirror: np.ndarray | None  # what a mirror line of amplitude 1 leaks (S, B, K), None for quadrature samples
    constant: np.ndarray  # what a constant of 1 leaks (S, B, K)
    mean: np.ndarray  # of the samples (S, B, 1) [LSB]

    def without_leakage(self, model: np.ndarray) -> np.ndarray:
        """Return the blocks without what leaks, by the amplitude `model` (S, B, K) of the line."""
        leaked = (model * self.constant.conj()).mean(axis=-1)[..., None]
        if self.mirror is None:
            return self.line - (self.mean - leaked) * self.constant
        return self.line - model.conj() * self.mirror - (self.mean - 2.0 * leaked.real) * self.constant


@dataclasses.dataclass(frozen=True)
class Lines:
    """The stations' lines about the frequencies of their demodulation."""

    frequency: np.ndarray  # (S, B) [cycles per sample]
    amplitude: np.ndarray  # at the window's centre, complex (S, B) [LSB]
    blocks: np.ndarray  # amplitude of each block, chirp included (S, B, K)


class BlockEstimator:
    """Lines of S stations in blocks of a sweep; a subclass says how the stations' lines combine."""

    def __init__(
        self, stations: tuple[MaximumLikelihoodEstimator, ...], signs: tuple[int, ...], blocks: range, chirp_known: bool
    ) -> None:
        """Prepare everything that does not depend on the samples.

        Args:
            stations: estimators of single stations.
            signs: of the first station's residual chirp in each line.
            blocks: lengths of a block to choose from [samples]; short ones show faster changes within the sweep.
            chirp_known: False if the chirp that remains after calibration may be large; it is then estimated.
        """
        self.stations, self._signs, self._chirp_known = stations, np.array(signs), chirp_known
        count = min(s.samples.stop - s.samples.start for s in stations)
        self._size = min(blocks, key=lambda n: (count % n, -n))
        self._count = count // self._size * self._size  # samples of each station that blocks cover
        index = (self._size - 1) / 2 + self._size * np.arange(count // self._size)
        # of the blocks, each station's counted from the centre of its own window (S, K) [samples]
        self._time = np.array([s.samples.start - s.origin + index for s in stations])
        self._weights = np.full(self._size, 1.0 / self._size, np.complex64)

    @property
    def block(self) -> int:
        """Length of a block [samples]."""
        return self._size

    def basebands(self, samples: Sequence[np.ndarray]) -> Basebands:
        """Return the lines of few sweeps over the time in the sweep, and their beat frequencies alone.

        Args:
            samples: of each station (B, sample_count), int16 or float, or (B, 2 sample_count) I, Q, ...; same sweeps.
        """
        return self._found(samples)[2]

    def spectra(self, samples: Sequence[np.ndarray]) -> tuple[tuple[np.ndarray, ...], np.ndarray]:
        """Return the power and the beat frequencies of few sweeps, see `Basebands`.

        The frequencies are those of a first round, which a line's chirp and mirror line still shift by a part of a bin.

        Args:
            samples: as for `basebands`.
        """
        found = [s.search(x) for s, x in zip(self.stations, samples, strict=True)]
        coarse, _, models = self._begun(found)
        tones = zip(self.stations, coarse, models.frequency, models.amplitude, strict=True)
        beat = [self._line(*each)[0] * each[0].sweep.sample_rate / each[0].length for each in tones]
        return tuple(f.power for f in found), np.array(beat)

    def with_basebands(
        self, samples: Sequence[np.ndarray], full_scale: float
    ) -> tuple[tuple[Estimates, ...], Basebands]:
        """Return all that is estimated of few sweeps, and the lines over the time in the sweep.

        Args:
            samples: as for `basebands`.
            full_scale: ADC code of full scale of all stations [LSB].
        """
        found, lines, basebands = self._found(samples)
        basebands = dataclasses.replace(basebands, power=tuple(p.copy() for p in basebands.power))
        scale = np.full(len(samples[0]), full_scale)  # `conclude` overwrites the power
        parts = zip(self.stations, found, lines, strict=True)
        return tuple(s.collect([s.conclude(f, *line, scale, None)]) for s, f, line in parts), basebands

    def _found(
        self, samples: Sequence[np.ndarray]
    ) -> tuple[list[Sweeps], list[tuple[np.ndarray, np.ndarray]], Basebands]:
        """Return each station's sweeps, its line, and the basebands, which share the sweeps' power."""
        found = [s.search(x) for s, x in zip(self.stations, samples, strict=True)]
        coarse, blocks, chirp, models = self._resolve(found)
        lines = self._combine(coarse, blocks, chirp, models)
        rates = np.array([s.sweep.sample_rate for s in self.stations])[:, None]
        bins = rates / np.array([s.length for s in self.stations])[:, None]
        origins = np.array([s.origin for s in self.stations])[:, None]
        basebands = Basebands(
            lines=blocks,
            frequency=np.array(coarse) * (bins / FINE),
            time=(self._time + origins) / rates,
            power=tuple(f.power for f in found),
            beat=np.array([frequency for frequency, _ in lines]) * bins,
        )
        return found, lines, basebands

    def _chirp(self, lines: np.ndarray) -> np.ndarray:
        """Return the chirp that the first station's line still has (B,) [cycles per sample^2], however strong it is."""
        raise NotImplementedError

    def _combine(
        self, coarse: list[np.ndarray], lines: np.ndarray, chirp: np.ndarray, models: Lines
    ) -> list[tuple[np.ndarray, np.ndarray]]:
        """Return (frequency [bins], complex amplitude of the windowed line) of each station, each (B,).

        Args:
            coarse: frequencies of the demodulation, of each station (B,) [1/FINE bin], all as of `_resolve`.
            lines: blocks free of leakage (S, B, K).
            chirp: that the first line has (B,) [cycles per sample^2].
            models: lines fitted to the blocks.
        """
        raise NotImplementedError

    def _resolve(self, found: Sequence[Sweeps]) -> tuple[list[np.ndarray], np.ndarray, np.ndarray, Lines]:
        """Return coarse frequencies of each station, blocks free of leakage, residual chirp and lines."""
        coarse, records, models = self._begun(found)
        for _ in range(1 if self._chirp_known else _ROUNDS):
            lines = records.without_leakage(models.blocks)
            chirp, models, _ = self._bent(lines)
        return coarse, lines, chirp, models

    def _begun(self, found: Sequence[Sweeps]) -> tuple[list[np.ndarray], _Demodulated, Lines]:
        """Return coarse frequencies of each station, blocks, and the lines of a first round, leakage included.

        The strongest bin of a line that bends over many may be any of them, as noise or its phase has it: such a line
        is demodulated at its mean frequency instead.
        """
        coarse = [station.coarse(sweeps) for station, sweeps in zip(self.stations, found, strict=True)]
        records = self._demodulate(found, coarse)
        if self._chirp_known:
            return coarse, records, self._fit(records.line, np.zeros(len(coarse[0])))
        _, models, bent = self._bent(records.line)
        if len(bent):
            for station, blocks, at in zip(self.stations, records.line[:, bent], coarse, strict=True):
                mean = mean_turn(blocks) / (2.0 * np.pi * self._size)  # cycles per sample
                at[bent] += np.rint(mean * station.length * FINE).astype(at.dtype)
            records = self._demodulate(found, coarse)
            models = self._bent(records.line)[1]
        return coarse, records, models

    def _bent(self, lines: np.ndarray) -> tuple[np.ndarray, Lines, np.ndarray]:
        """Return what is fitted to lines with a residual chirp.

        Noise may feign a chirp. A line that is stronger without it has none. A line that bends otherwise than by a
        chirp leaves the tone as well, but not in noise: the power of its blocks is steady. They are its model then.

        Args:
            lines: blocks (S, B, K).

        Returns:
            first line's chirp (B,) [cycles per sample^2], lines, and numbers of the sweeps that bend otherwise.
        """
        chirp = self._chirp(lines)
        models = self._fit(lines, chirp)
        shown = total_power(models.amplitude)
        doubtful = np.flatnonzero(shown < _CLEAR * total_power(lines).mean(axis=-1))
        steady = is_steady(lines[:, doubtful])
        bent, doubtful = doubtful[steady], doubtful[~steady]
        if len(doubtful):
            straight = total_power(tone(lines[:, doubtful], self._time[:, None], self._size)[1])
            feigned = doubtful[straight > shown[doubtful]]
            if len(feigned):
                chirp[feigned] = 0.0
                models = self._fit(lines, chirp)
        models.blocks[:, bent] = lines[:, bent]
        return chirp, models, bent

    def _fit(self, lines: np.ndarray, chirp: np.ndarray) -> Lines:
        """Return the lines of blocks (S, B, K), the first one's residual chirp given (B,) [cycles per sample^2]."""
        time = self._time[:, None]
        bend = rotation(0.5 * self._signs[:, None] * chirp, time**2)
        frequency, amplitude = tone(lines * bend.conj(), time, self._size)
        bend *= rotation(frequency, time)
        bend *= amplitude.astype(np.complex64)[..., None]
        return Lines(frequency, amplitude, bend)

    def _demodulate(self, found: Sequence[Sweeps], coarse: list[np.ndarray]) -> _Demodulated:
        """Return the stations' sweeps in blocks.

        Args:
            found: of each station's search.
            coarse: frequency of each station's demodulation (B,) [1/FINE bin].
        """
        lines, mirrors, constants, means = [], [], [], []
        for station, sweeps, at in zip(self.stations, found, coarse, strict=True):
            start = station.samples.start
            record = sweeps.record[:, start : start + self._count]
            carrier = station.carrier(at)[:, : self._count]
            lines.append(self._means(record * carrier))
            constants.append(self._means(carrier))
            means.append(record.mean(axis=1)[:, None])
            if not station.iq:
                mirrors.append(self._means(carrier * carrier))
        return _Demodulated(
            np.stack(lines), np.stack(mirrors) if mirrors else None, np.stack(constants), np.stack(means)
        )

    def _means(self, values: np.ndarray) -> np.ndarray:
        """Return the mean of each block (B, K) of values (B, N)."""
        return np.matmul(values.reshape(len(values), -1, self._size), self._weights)

    def _line(
        self, station: MaximumLikelihoodEstimator, coarse: np.ndarray, frequency: np.ndarray, amplitude: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray]:
        """Return (frequency [bins], complex amplitude of the windowed line), (B,) each.

        Args:
            station: whose line.
            coarse: frequency of the demodulation (B,) [1/FINE bin].
            frequency: of the blocks' tone (B,) [cycles per sample].
            amplitude: of the same at the window's centre (B,) [LSB].
        """
        # a block's mean lowers a line beside the frequency of the demodulation
        loss = np.sinc(self._size * frequency) / np.sinc(frequency)
        return coarse / FINE + frequency * station.length, amplitude / loss * station.window_sum


class SingleEstimator(BlockEstimator):
    """One station's line in blocks: of a station that hears itself, or whose peer's samples are not available."""

    def __init__(
        self,
        sweep: SweepSettings,
        settings: EstimatorSettings,
        iq: bool = False,
        own: Calibration | None = None,
        peer: Calibration | None = None,
        blocks: range = BLOCKS,
    ) -> None:
        """Prepare everything that does not depend on the samples.

        Args:
            sweep: the station's settings.
            settings: of the estimation.
            iq: quadrature samples.
            own: the station's calibration, None where unknown.
            peer: the peer's; ignored where the station hears itself.
            blocks: lengths of a block to choose from [samples].

        Raises:
            ConfigurationError: the settings leave no window or no frequency to search.
        """
        super().__init__((MaximumLikelihoodEstimator(sweep, settings, iq, own, peer),), (1,), blocks, False)

    def _chirp(self, lines: np.ndarray) -> np.ndarray:
        if self.stations[0].sweep.hears_itself:
            return np.zeros(
                len(lines[0])
            )  # one oscillator has no residual chirp; estimating it would cost phase accuracy
        return chirp_of(lines[0], self._size, 1)

    def _combine(
        self, coarse: list[np.ndarray], lines: np.ndarray, chirp: np.ndarray, models: Lines
    ) -> list[tuple[np.ndarray, np.ndarray]]:
        return [
            self._line(*each) for each in zip(self.stations, coarse, models.frequency, models.amplitude, strict=True)
        ]
