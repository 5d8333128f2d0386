"""Sweeps in, beat frequencies out: settings and calibrations looked up by stamp, work shared over the batch.

The station node and the offline replay call this same class. Every look-up uses the sweep's stamp and every estimate is
independent of the batch, so both give bit-identical numbers.
"""

import collections
import contextlib
import functools
import math
from collections.abc import Callable, Sequence
from typing import Any

import numpy as np

from drfmcw_physics.oscillators import Calibration
from drfmcw_physics.rules.history import WHOLE, History
from drfmcw_physics.rules.plausible import printable_line
from drfmcw_physics.settings import ConfigurationError
from drfmcw_physics.sweep import SweepSettings

from ..estimators.estimation import Estimates, Estimator, EstimatorSettings, Flag
from ..estimators.registry import estimator
from .records import Beat, Spectrum, Sweep

Wanted = Callable[[Sweep], bool] | None
"""Says whether a sweep's spectrum is wanted; None: no sweep's."""

OTHER_REASONS = 'other reasons'
"""Stands for what no longer counts by itself."""
_TEMPERATURE_STEP = 1.0  # of boards, between two estimators [K]
_BLOCK = 64  # samples that no two records share by chance
_FEWEST_VALUES = 8  # in a block that is noise
_MOST_REASONS = 32
_LONGEST_REASON = 120


class StationProcessor:
    """Turns sweeps of any stations into beat frequencies."""

    def __init__(self, settings: EstimatorSettings | None = None, kept: int = WHOLE) -> None:
        """Start without settings of the sweep and without calibrations; of each so many values are `kept`."""
        history = functools.partial(History, kept)
        self._settings = settings or EstimatorSettings()
        self._sweep_settings: dict[tuple[str, str], History[SweepSettings]] = collections.defaultdict(history)
        self._calibrations: dict[str, History[Calibration]] = collections.defaultdict(history)
        self._board_temperatures: dict[str, History[float]] = collections.defaultdict(history)
        self._at_temperature: dict[tuple[int, int], Calibration] = {}  # by calibration and step of temperature
        self._estimators: dict[tuple, Estimator | str] = {}
        self._newest_samples: dict[tuple[str, str], tuple[int, np.ndarray]] = {}
        self.sweeps = 0
        """Sweeps given since start."""
        self.weak = 0
        """Sweeps whose line was too weak, since start."""
        self.dropped: collections.Counter[str] = collections.Counter()
        """Number of sweeps without any result, by reason, since start."""

    @property
    def settings(self) -> EstimatorSettings:
        """Settings of the estimation; a new value holds from the next batch on."""
        return self._settings

    @settings.setter
    def settings(self, value: EstimatorSettings) -> None:
        self._settings = value
        self._forget_estimators()

    def add_sweep_config(self, settings: SweepSettings) -> None:
        """Add settings of a station and its peer, valid from their stamp on."""
        self._sweep_settings[settings.station, settings.peer].add(settings.stamp, settings)
        self._forget_estimators()
        self._prepare(settings)

    def add_calibration(self, calibration: Calibration) -> None:
        """Add a station's calibration, valid from its stamp on."""
        self._calibrations[calibration.station].add(calibration.stamp, calibration)
        self._forget_estimators()
        for pair, history in self._sweep_settings.items():
            newest = history.latest()
            if calibration.station in pair and newest is not None:
                self._prepare(newest)

    def add_board_temperature(self, station: str, stamp: int, temperature: float) -> None:
        """Add a station's board temperature [degC], valid from its stamp [ns] on; NaN is ignored."""
        if math.isfinite(temperature):
            self._board_temperatures[station].add(stamp, temperature)

    def _forget_estimators(self) -> None:
        """Forget the prepared estimators, because settings or calibrations changed."""
        self._estimators.clear()
        self._at_temperature.clear()

    def _prepare(self, settings: SweepSettings) -> None:
        """Make the estimator of the newest settings now (tens of ms), so that the first sweep need not wait for it."""
        histories = [self._calibrations.get(s) for s in (settings.station, settings.peer)]
        own, peer = (None if history is None else history.latest() for history in histories)
        if own is not None and peer is not None:
            with contextlib.suppress(ConfigurationError):  # reported when a sweep comes that needs it
                estimator(settings, self._settings, False, own, peer)

    def has_settings(self, sweep: Sweep) -> bool:
        """Return True where the settings and calibrations that a sweep needs have arrived."""
        histories = (
            self._sweep_settings.get((sweep.station, sweep.peer)),
            self._calibrations.get(sweep.station),
            self._calibrations.get(sweep.peer),
        )
        return all(history is not None and history.at(sweep.stamp) is not None for history in histories)

    def drop(self, reason: str) -> None:
        """Count a sweep without a result; so many reasons, of so many letters, that what is outside cannot fill it."""
        reason = printable_line(reason, _LONGEST_REASON)
        self.dropped[reason if reason in self.dropped or len(self.dropped) < _MOST_REASONS else OTHER_REASONS] += 1

    def process(self, sweeps: Sequence[Sweep]) -> list[Beat]:
        """Return the beat frequencies of sweeps that can be evaluated, in order; the others count in `dropped`."""
        return self._process(sweeps, None)[0]

    def process_with_spectra(
        self, sweeps: Sequence[Sweep], wanted: Callable[[Sweep], bool]
    ) -> tuple[list[Beat], list[Spectrum]]:
        """Return the beat frequencies, and the magnitude spectra of sweeps for which `wanted`, called once, is True."""
        return self._process(sweeps, wanted)

    def _process(self, sweeps: Sequence[Sweep], wanted: Wanted) -> tuple[list[Beat], list[Spectrum]]:
        groups: dict[int, tuple[Estimator, list[int], list[np.ndarray]]] = {}
        for index, sweep in enumerate(sweeps):
            chosen = self._estimator(sweep)
            samples = np.asarray(sweep.samples)
            reason = chosen if isinstance(chosen, str) else refusal(sweep, samples, chosen.sweep.sample_count)
            if isinstance(chosen, str) or reason:
                self.drop(reason)
                continue
            if self._holds_old_noise(sweep, samples):
                self.drop(f'samples of {sweep.station} are in part those of the sweep before')
                continue
            _, indices, rows = groups.setdefault(id(chosen), (chosen, [], []))
            indices.append(index)
            rows.append(samples)
        self.sweeps += len(sweeps)
        beats: list[Beat | None] = [None] * len(sweeps)
        spectra: list[Spectrum | None] = [None] * len(sweeps)
        for chosen, indices, rows in groups.values():
            group = [sweeps[i] for i in indices]
            mask = wanted_spectra(group, wanted)
            result = chosen(np.stack(rows), np.array([s.full_scale for s in group]), mask)
            of_group = self._results(group, result, mask)
            for index, beat, spectrum in zip(indices, *of_group, strict=True):
                beats[index], spectra[index] = beat, spectrum
        return [b for b in beats if b is not None], [s for s in spectra if s is not None]

    def _holds_old_noise(self, sweep: Sweep, samples: np.ndarray) -> bool:
        """Return whether a buffer was not, or not wholly, filled anew; remembers the sweep."""
        key = (sweep.station, sweep.peer)
        before = self._newest_samples.get(key)
        self._newest_samples[key] = sweep.stamp, samples
        if before is None or before[0] == sweep.stamp or before[1].shape != samples.shape:
            return False
        return shares_noise(before[1], samples)

    def _results(
        self, sweeps: Sequence[Sweep], result: Estimates, mask: np.ndarray | None
    ) -> tuple[list[Beat], list[Spectrum | None]]:
        """Return the results of sweeps evaluated together, None for a spectrum not wanted; counts weak lines."""
        spectra: list[Spectrum | None] = [None] * len(sweeps)
        if mask is not None and result.spectrum is not None:
            window = self._settings.window
            for row, magnitude in zip(np.flatnonzero(mask).tolist(), result.spectrum, strict=True):
                spectra[row] = _spectrum(sweeps[row], window, result, magnitude)
        self.weak += int(np.count_nonzero(result.flags & np.uint8(Flag.WEAK_SIGNAL)))
        return _beats(sweeps, result), spectra

    def _conditions(self, sweep: Sweep) -> tuple[SweepSettings, Calibration, Calibration] | str:
        """Return the sweep's settings, its station's and its peer's calibration, or why one is missing."""
        settings = _holding(self._sweep_settings.get((sweep.station, sweep.peer)), sweep.stamp)
        if settings is None:
            return f'no sweep settings of {sweep.station} for {sweep.peer} from before the sweep'
        calibrations = []
        for station in (sweep.station, sweep.peer):
            calibration = _holding(self._calibrations.get(station), sweep.stamp)
            if calibration is None:
                return f'no calibration of {station} from before the sweep'
            calibrations.append(self._warm(calibration, station, sweep.stamp))
        return settings, *calibrations

    def _warm(self, calibration: Calibration, station: str, stamp: int) -> Calibration:
        """Return a calibration as it holds at the board's temperature, in steps of `_TEMPERATURE_STEP`.

        The clocks move the residual chirp, which smears a line by a tenth of a bin in such a step; the range uses the
        temperature itself.
        """
        temperature = _holding(self._board_temperatures.get(station), stamp)
        if temperature is None or not calibration.depends_on_temperature:
            return calibration
        step = round(temperature / _TEMPERATURE_STEP)
        key = id(calibration), step
        if key not in self._at_temperature:
            self._at_temperature[key] = calibration.at(step * _TEMPERATURE_STEP)
        return self._at_temperature[key]

    def _estimator(self, sweep: Sweep) -> Estimator | str:
        """Return the estimator for the sweep's settings and calibrations, or why there is none."""
        conditions = self._conditions(sweep)
        if isinstance(conditions, str):
            return conditions
        settings, own, peer = conditions
        key = (id(settings), id(own), id(peer), sweep.iq)
        chosen = self._estimators.get(key)
        if chosen is None:
            try:
                chosen = estimator(settings, self._settings, sweep.iq, own, peer)
            except ConfigurationError as error:
                chosen = str(error)
            self._estimators[key] = chosen
        return chosen


def _holding(history: History | None, stamp: int) -> Any:
    """Return the value that holds at `stamp`, None where none does."""
    found = history.at(stamp) if history is not None else None
    return None if found is None else found[1]


def wanted_spectra(sweeps: Sequence[Sweep], wanted: Wanted) -> np.ndarray | None:
    """Return which sweeps' spectra are wanted; None for none of them."""
    if wanted is None:
        return None
    mask = np.array([wanted(sweep) for sweep in sweeps])
    return mask if mask.any() else None


def refusal(sweep: Sweep, samples: np.ndarray, sample_count: int) -> str:
    """Return why a sweep cannot be evaluated, '' where it can."""
    expected = sample_count * (2 if sweep.iq else 1)
    if samples.ndim != 1 or samples.dtype != np.int16:
        return f'samples of {sweep.station} are not a row of int16'
    if len(samples) != expected:
        kind = 'I/Q ' if sweep.iq else ''
        return f'{len(samples)} samples of {sweep.station}, but {expected} {kind}follow from its settings'
    if not (math.isfinite(sweep.full_scale) and sweep.full_scale > 0.0):
        return f'full_scale = {sweep.full_scale:g} of {sweep.station} is not a positive number'
    return ''


def shares_noise(one: np.ndarray, other: np.ndarray) -> bool:
    """Return whether two records (n,) of int16 hold the same noise somewhere: 64 equal samples in a row of many values.

    With noise of a standard deviation of half a code or more, two different records agree in one sample with a
    probability of 0.53 at most, and so in one of 32 blocks with 1e-16.
    """
    count = len(one) // _BLOCK
    if not count:
        return False
    blocks = one[: count * _BLOCK].reshape(count, _BLOCK)
    equal = (blocks == other[: count * _BLOCK].reshape(count, _BLOCK)).all(axis=1)
    # zeros, a constant and a clipped line repeat without a fault
    return any(len(set(block.tolist())) >= _FEWEST_VALUES for block in blocks[equal])


def _beats(sweeps: Sequence[Sweep], result: Estimates) -> list[Beat]:
    names = ('flags', 'frequency', 'frequency_std', 'phase', 'power', 'snr', 'independent_std')
    columns = [getattr(result, name).tolist() for name in names]
    return [
        Beat(
            s.station,
            s.peer,
            s.sweep_id,
            flags,
            frequency,
            std,
            phase,
            power,
            snr,
            s.stamp,
            s.frame_id,
            alone,
            result.window,
        )
        for s, flags, frequency, std, phase, power, snr, alone in zip(sweeps, *columns, strict=True)
    ]


def _spectrum(sweep: Sweep, window: str, result: Estimates, magnitude: np.ndarray) -> Spectrum:
    return Spectrum(
        sweep.station,
        sweep.peer,
        sweep.sweep_id,
        window,
        result.spectrum_start,
        result.spectrum_step,
        magnitude,
        sweep.stamp,
        sweep.frame_id,
    )
