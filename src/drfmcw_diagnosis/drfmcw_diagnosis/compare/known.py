"""What settings, calibrations, weather and reference specify of a recording; the rest is not compared."""

from collections.abc import Sequence

import numpy as np

from drfmcw_node.estimators.estimation import Flag
from drfmcw_physics.constants import SPEED_OF_LIGHT

from ..recording.dataset import Dataset
from .limits import MODEL, SCATTER


class Known:
    """What can be predicted of each group of sweeps: G groups, S stations with samples."""

    def __init__(
        self, data: Dataset, heard: Sequence[int], members: Sequence[np.ndarray], scatters: bool, unsound: int = 0
    ) -> None:
        """Remember what is compared.

        Args:
            data: the recording.
            heard: numbers of the stations with samples.
            members: sweeps of each group.
            scatters: whether each group has enough sweeps to determine its scatter.
            unsound: number of sweeps left out because their lines were not where they should be.
        """
        self._unsound = unsound
        self._data, self._heard, self._members, self._scatters = data, heard, members, scatters
        self._alone = data.topology.one_missing
        self._delays = not any(f'/{station}/calibration' in data.lacking for station in data.stations)
        self._weather = not any(topic.startswith('/site/') for topic in data.lacking)
        self._referenced = np.array([np.isfinite(data.reference[m]).all() for m in members])

    @property
    def trust(self) -> float:
        """To which the forward models are trusted, relative to what they add."""
        return MODEL.forward if self._weather else MODEL.forward_in_unknown_air

    def range(self) -> np.ndarray:
        """Return in which groups the reference and the calibrated delays determine the range (G,)."""
        return self._referenced & self._delays

    def range_limit(self) -> np.ndarray:
        """Return to how much the range is trusted beyond its noise (G,) [m]: zero if all else is known."""
        limit = np.array([self._data.reference_limit[m].mean() for m in self._members])
        if not self._weather:
            limit = np.hypot(limit, MODEL.air * np.array([self._data.distance[m].mean() for m in self._members]))
        if self._alone:  # T_off stands in the range of one line
            start_delay = MODEL.beat / (2.0 * abs(self._data.sweeps[0][0].chirp_rate))
            limit = np.hypot(limit, start_delay * SPEED_OF_LIGHT)
        return limit

    def distance(self) -> np.ndarray:
        """Return in which groups the distance is known beyond doubt (G,)."""
        # one line of two stations determines the distance no better than T_off is known
        return self._referenced | (self._delays and not self._alone)

    def power(self) -> np.ndarray:
        """Return where the link budget determines the received power (G, S)."""
        known = []
        for m in self._members:
            sweeps = self._data.sweeps[self._data.setting[m[0]]]
            known.append([np.isfinite(sweeps[-1 - i].tx_eirp + sweeps[i].rx_antenna_gain) for i in self._heard])
        return np.array(known) & self.distance()[:, None]

    def noise(self) -> np.ndarray:
        """Return of which stations the calibrations specify floor and skirts (S,)."""
        skirts = all(np.isfinite(c.phase_noise_level + c.phase_noise_corner) for c in self._data.calibration)
        return np.array([skirts and not self._data.noise_measured[i] for i in self._heard])

    def undetermined(self) -> tuple[str, ...]:
        """Return what these samples cannot determine, in sentences."""
        said = []
        if self._alone:
            said.append(
                f"Station '{self._data.stations[self._heard[0]]}' alone does not show movement by its phase. Its "
                'oscillator noise does not cancel, so it hides small effects on the chirps'
            )
        if not self.distance().all():
            said.append('Received power is not compared where the distance is not accurate enough')
        lost = np.count_nonzero(self._data.lines.flags[0] & Flag.NEAR_DC) if self._data.topology.hears_itself else 0
        if lost:
            said.append(f'Left out: {lost} sweeps whose line is too near 0 Hz')
        if self._unsound:
            said.append(
                f'Left out: {self._unsound} sweeps whose lines were mistaken, hardly stand out of the noise or of '
                'other lines, are far weaker than before and after, or are too near 0 Hz or the Nyquist frequency, as '
                'far lines are where the references differ much'
            )
        if not self._data.topology.has_mirror:
            said.append('Negative frequencies of the I/Q samples are not compared')
        if not self.noise().all():
            said.append('Noise is not compared: the calibrations do not specify it completely')
        if not self._scatters:
            said.append(
                f'Fewer than {SCATTER.fewest} sweeps under the same conditions: only white noise is assumed between '
                'them, so any other change from sweep to sweep counts as a mismatch'
            )
        return tuple(said)
