"""Both stations' sweeps evaluated jointly, where the raw samples of both are available.

The two sweeps share the oscillators' noise and the chirp that different references leave on the lines, with opposite
signs. Both are demodulated in the same blocks (`blocks`). The product of both basebands (one conjugated in
short-distance mode) is then a tone at the combined beat frequency, in which all of it cancels, however strong it is and
whether or not it is calibrated.
"""

import functools

import numpy as np

from drfmcw_physics.oscillators import Calibration
from drfmcw_physics.settings import ConfigurationError
from drfmcw_physics.sweep import Role, SweepSettings

from .blocks import BLOCKS, BlockEstimator, Lines
from .estimation import Estimates, EstimatorSettings, Sweeps
from .maximum_likelihood import MaximumLikelihoodEstimator
from .tones import chirp_of, tone

_CHUNK = 1 << 17  # samples of one station worked on at once: the temporaries of both stay in the cache


class PairEstimator(BlockEstimator):
    """Estimates both stations' beat frequencies from both stations' samples.

    Each single frequency is as accurate as one station's samples allow. The frequencies combine to the frequency of the
    product of both sweeps, and the phases to its phase.
    """

    def __init__(
        self,
        first: SweepSettings,
        second: SweepSettings,
        settings: EstimatorSettings,
        iq: bool = False,
        first_calibration: Calibration | None = None,
        second_calibration: Calibration | None = None,
        blocks: range = BLOCKS,
        chirp_known: bool = True,
    ) -> None:
        """Prepare everything that does not depend on the samples.

        Args:
            first: settings of the station that starts first.
            second: of the other.
            settings: of the estimation.
            iq: quadrature samples.
            first_calibration: None where unknown; the residual chirp is then estimated.
            second_calibration: None where unknown.
            blocks: lengths of a block to choose from [samples]; short ones show faster changes within the sweep.
            chirp_known: False if the chirp that remains after calibration may be large; it is then estimated.

        Raises:
            ConfigurationError: the stations do not sweep alike, or leave no frequency to search.
        """
        alike = ('mode', 'bandwidth', 'ramp_duration', 'start_delay', 'sample_rate', 'sample_count')
        for name in alike:
            if getattr(first, name) != getattr(second, name):
                raise ConfigurationError(
                    f'{name} of {first.station} and {second.station} differ: '
                    f'{getattr(first, name):g} and {getattr(second, name):g}'
                )
        if (first.role, second.role) != (Role.FIRST, Role.SECOND):
            raise ConfigurationError(f'{first.station} and {second.station}: need one first and one second station')
        chirp_known = chirp_known and None not in (first_calibration, second_calibration)
        self._sign = first.line_sign() * second.line_sign()
        stations = (
            MaximumLikelihoodEstimator(first, settings, iq, first_calibration, second_calibration),
            MaximumLikelihoodEstimator(second, settings, iq, second_calibration, first_calibration),
        )
        super().__init__(stations, (1, self._sign), blocks, chirp_known)
        self._late = self._time[1][0] - self._time[0][0]

    def __call__(
        self,
        first: np.ndarray,
        second: np.ndarray,
        full_scale: tuple[np.ndarray | float, np.ndarray | float],
        spectrum: np.ndarray | None = None,
    ) -> tuple[Estimates, Estimates]:
        """Estimate the beat frequencies of each pair of sweeps.

        Args:
            first: int16 (B, sample_count) of the first station, or (B, 2 sample_count) I, Q, I, Q, ...
            second: of the second station, the same sweeps.
            full_scale: ADC code of full scale of each station [LSB], scalars or (B,).
            spectrum: mask (B,) of the sweeps whose magnitude spectra are wanted; None for no spectra.
        """
        scales = [np.broadcast_to(np.asarray(f, float), len(first)) for f in full_scale]
        rows = max(_CHUNK // self.stations[0].sweep.sample_count, 1)
        parts: tuple[list, list] = ([], [])
        for i in range(0, len(first), rows):
            chunk = slice(i, i + rows)
            wanted = None if spectrum is None else spectrum[chunk]
            found = [s.search(x[chunk]) for s, x in zip(self.stations, (first, second), strict=True)]
            lines = self._refine(*found)
            for part, station, sweeps, line, scale in zip(parts, self.stations, found, lines, scales, strict=True):
                part.append(station.conclude(sweeps, *line, scale[chunk], wanted))
        one, other = (s.collect(p) for s, p in zip(self.stations, parts, strict=True))
        return one, other

    def _refine(self, *found: Sweeps) -> list[tuple[np.ndarray, np.ndarray]]:
        """Return (frequency [bins], complex amplitude of the windowed line) of each station, each (B,)."""
        return self._combine(*self._resolve(found))

    def _combine(
        self, coarse: list[np.ndarray], lines: np.ndarray, chirp: np.ndarray, models: Lines
    ) -> list[tuple[np.ndarray, np.ndarray]]:
        """Return what `_refine` does, from what `_resolve` found."""
        (one, two), (first, second) = models.frequency, models.amplitude
        combined, value = tone(self._products(lines)[0], self._time[0], self._size, one - self._sign * two)
        combined += chirp * self._late  # the second station's blocks come later by part of a sample
        turns = two * self._late + 0.5 * self._sign * chirp * self._late**2
        value = value * np.exp(2j * np.pi * self._sign * turns)  # in place, a single row would round differently
        error = 0.5 * (combined - (one - self._sign * two))
        single = first * (second.conj() if self._sign > 0 else second)
        slip = 0.5 * np.angle(value * single.conj())
        shares = np.array([1.0, -self._sign])[:, None]
        frequency, amplitude = models.frequency + shares * error, models.amplitude * np.exp(1j * shares * slip)
        return [self._line(*each) for each in zip(self.stations, coarse, frequency, amplitude, strict=True)]

    def _products(self, lines: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Return the product in which what both lines share cancels, and the one that has it twice, (B, K) each."""
        straight, conjugate = lines[0] * lines[1], lines[0] * lines[1].conj()
        return (conjugate, straight) if self._sign > 0 else (straight, conjugate)

    def _chirp(self, lines: np.ndarray) -> np.ndarray:
        """Return the chirp that the first station's line still has (B,) [cycles per sample^2], however strong it is."""
        return chirp_of(self._products(lines)[1], self._size, 2)


class PartnerlessEstimator(MaximumLikelihoodEstimator, name='pair'):
    """Both stations' sweeps together (`PairEstimator`); this, maximum likelihood, for a sweep without its partner."""


@functools.lru_cache(maxsize=32)
def pair_estimator(
    first: SweepSettings,
    second: SweepSettings,
    settings: EstimatorSettings,
    iq: bool = False,
    first_calibration: Calibration | None = None,
    second_calibration: Calibration | None = None,
) -> PairEstimator:
    """Return the estimator of a pair, prepared for one setting; arguments as for `PairEstimator`."""
    return PairEstimator(first, second, settings, iq, first_calibration, second_calibration)
