"""The noise that the model expects: floor and skirts in bands, and what both stations' lines have in common."""

import warnings
from collections.abc import Sequence

import numpy as np

from drfmcw_node.noise import QUANTISATION
from drfmcw_physics.phase_noise import combination_gain
from drfmcw_sim.effects import Effect
from drfmcw_sim.effects.base import Stage
from drfmcw_sim.signal_model import Measurements, Station

from . import coherence
from .features import BANDS, LINE
from .groups import Part
from .recorded_sweeps import RecordedSweeps

_FLOOR_LIMIT = 0.02  # what the model of a white floor is trusted to [dB]
_SKIRT_LIMIT = 0.1  # and that of the oscillators' skirts [dB]
_DELAY_STEP = 1e-9  # that turns no sideband's phase noticeably [s]
_FREQUENCIES = 16  # of each band at which the skirts are taken


class NoiseModel:
    """Noise of a recording's G groups, in closed form; S stations with samples."""

    def __init__(self, recorded: RecordedSweeps, shared: np.ndarray) -> None:
        """Remember whose noise it is.

        Args:
            recorded: sweeps whose lines have the skirts.
            shared: in which groups the coherence of both lines' noise is compared (G,).
        """
        self._sweeps, self._heard, self._iq = recorded.sweeps, recorded.heard, recorded.data.iq
        self._parts, self._shared = recorded.parts, shared
        self._known: dict[tuple, np.ndarray] = {}  # coherences by what they depend on

    def predicted(
        self, part: Part, state: Measurements, effects: Sequence[Effect], line: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray]:
        """Return the noise of each group in bands [dB of 1 LSB^2 per sample] (G, S, BANDS), and the coherence of both.

        Skirts go with the power that a line has, whatever made it.

        Args:
            part: groups of one setting.
            state: their conditions after effects.
            effects: of which filters pass noise by its frequency.
            line: of each station (G, S) [Hz].
        """
        rate = state.stations[0].sweep.sample_rate
        centre = (np.arange(BANDS * _FREQUENCIES) + 0.5) * (rate / 2 / (BANDS * _FREQUENCIES))
        oscillators = [s.phase_noise for s in state.stations if s.phase_noise is not None]
        amplitude = np.array([self._sweeps[g].amplitude.mean(axis=0) for g in part.groups])
        powers = 10.0 ** (amplitude / 10.0) * (1.0 if self._iq else 0.25)  # at each frequency of a line
        result = np.empty((len(line), len(self._heard), BANDS))
        for number, heard in enumerate(self._heard):
            station = state.stations[heard]
            at, own = centre[None, :], line[:, number, None]
            offsets = np.stack([np.abs(at - own), np.minimum(at + own, rate - at - own)])
            if self._iq:  # all of the line at one frequency, no mirror line
                offsets = np.minimum(offsets[:1], rate - offsets[:1])
            density = sum((o.single_sideband(offsets) for o in oscillators), np.zeros_like(offsets))
            if len(state.stations) == 1:  # the oscillator meets itself, a delay later
                density = density * combination_gain(offsets, state.paths[0].delay[:, None])
            density = density.sum(axis=0)
            inside = np.abs(at - own) < LINE * (rate / 2 / (self._sweeps[0].power.shape[-1] - 1))
            passed = np.abs(self._response(station, state, effects, centre)) ** 2
            # the line's own power has passed the filters already
            share = passed / np.abs(self._response(station, state, effects, line[:, number])[:, None]) ** 2
            skirts = share * density * rate * powers[:, number, None]
            total = self._floor(station, passed) + np.where(inside, np.nan, skirts)
            bands = total.reshape(len(line), BANDS, _FREQUENCIES)
            with warnings.catch_warnings():
                warnings.simplefilter('ignore', RuntimeWarning)  # a band that a line fills is not compared
                result[:, number] = 10.0 * np.log10(np.nanmedian(bands, axis=2))
        decisive = (
            int(part.groups[0]),
            *oscillators,
            *(e for e in effects if e.stage == Stage.FILTER),
            *(s.noise_density.tobytes() for s in state.stations),
            np.rint(state.paths[0].delay / _DELAY_STEP).tobytes(),
        )
        if decisive not in self._known:
            self._known[decisive] = self._coherence(part, state, effects, powers)
        return result, self._known[decisive]

    def limit(self, noise: np.ndarray) -> np.ndarray:
        """Return to what the noise in bands, `noise` without effects, is trusted [dB]: less where a skirt rules.

        Both (G, S, BANDS).
        """
        limit = np.empty(noise.shape)
        for part in self._parts:
            floor = np.stack([self._floor(part.steady.stations[i], np.ones(1)) for i in self._heard], axis=1)
            share = 1.0 - floor / 10.0 ** (noise[part.groups] / 10.0)
            limit[part.groups] = _FLOOR_LIMIT + _SKIRT_LIMIT * np.clip(share, 0.0, 1.0)
        return limit

    def _coherence(self, part: Part, state: Measurements, effects: Sequence[Effect], powers: np.ndarray) -> np.ndarray:
        """Return the coherence of both lines' phase noise in each group (G, OFFSETS); zero where it is not compared.

        Args:
            part: groups of one setting.
            state: their conditions after effects.
            effects: of which filters pass sidebands by their frequency.
            powers: of the lines, at positive frequency (G, S) [LSB^2].
        """
        result = np.zeros((len(part.groups), coherence.OFFSETS))
        if not self._shared[part.groups].any():
            return result
        rate = state.stations[0].sweep.sample_rate
        oscillators = [s.phase_noise for s in state.stations]
        for row, g in enumerate(part.groups):
            line = self._sweeps[g].line.mean(axis=0)
            used = coherence.sidebands(line, state.stations[0].sweep)
            floors, responses = [], []
            for station, at, power in zip(state.stations, line, powers[row], strict=True):
                sides = np.clip(at + np.stack([used.offset, -used.offset]), 0.0, rate / 2)
                response = self._response(station, state, effects, sides)
                one = state.rows(slice(row, row + 1))
                station = next(s for s in one.stations if s.name == station.name)
                own = self._response(station, state, effects, np.array([at]))
                floor = self._floor(station, np.abs(response.reshape(-1)) ** 2).reshape(sides.shape)
                # what the mirror lines' skirts bring there has a phase of its own
                mirrors = sum(o.single_sideband(m) for o in oscillators for m in (at + sides, rate - at - sides))
                responses.append(response / own)
                floors.append(floor / (rate * power) + mirrors * np.abs(responses[-1]) ** 2)
            result[row] = coherence.predicted(
                used,
                np.array([o.single_sideband(used.offset) for o in oscillators]),
                np.array(floors),
                np.array(responses),
                float(state.paths[0].delay[row]),
            )
        return result

    def _response(
        self, station: Station, state: Measurements, effects: Sequence[Effect], frequency: np.ndarray
    ) -> np.ndarray:
        """Return by how much the filters among `effects` pass frequencies (...) of a station's IF, complex."""
        filters = [e for e in effects if e.stage == Stage.FILTER and e.applies_to(station.name)]
        if not filters:
            return np.ones(frequency.shape)
        one = state.rows(slice(0, 1))
        count = station.sweep.sample_count
        impulse = np.zeros((1, count, 2) if self._iq else (1, count), np.float32)
        impulse[0, count // 2] = 1.0  # a cut at the Nyquist frequency rings both ways
        for effect in filters:
            effect.receive(impulse, next(s for s in one.stations if s.name == station.name), one, list)
        spectrum = np.fft.rfft(impulse[..., 0] if self._iq else impulse, axis=1)[0]
        spectrum *= np.exp(2j * np.pi * (count // 2) / count * np.arange(len(spectrum)))  # time counts from the impulse
        return np.interp(frequency, np.arange(len(spectrum)) * station.sweep.sample_rate / count, spectrum)

    def _floor(self, station: Station, passed: np.ndarray) -> np.ndarray:
        """Return the variance of a sample without skirts (n, k) [LSB^2], of both of its parts with iq.

        Args:
            station: n sweeps of it.
            passed: share of the noise before the ADC that filters leave (k,).
        """
        before = station.noise_std()[:, None] ** 2 * passed
        return (before + QUANTISATION) * (2.0 if self._iq else 1.0)
