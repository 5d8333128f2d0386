"""Noise in bands of equal width beside the lines: what a spectrum shows of it, and what further lines make of that."""

from collections.abc import Sequence

import numpy as np
from scipy.special import ndtr

from drfmcw_physics.constants import DECIBELS_PER_NEPER

from .limits import SPECTRUM
from .spectra import median_of_mean, near_line, row_medians


class NoiseBands:
    """The bands of spectra under one sample rate and window, of S stations; there are N bands."""

    def __init__(self, rate: float, window_power: Sequence[float]) -> None:
        """Remember what makes a spectrum.

        Args:
            rate: sample rate [Hz].
            window_power: mean power that noise of 1 LSB^2 per sample has in a bin, of each station (S,) [LSB^2].
        """
        self._rate, self._window_power = rate, np.array(window_power)

    def at_line(self, line: np.ndarray, bins: int) -> np.ndarray:
        """Return which bins (..., B) are left to the features of the lines themselves; `line` (...) [Hz]."""
        return near_line(bins, line, self._rate / 2 / (bins - 1), self._rate)

    def measured(self, power: np.ndarray, line: np.ndarray, count: np.ndarray) -> np.ndarray:
        """Return the noise in bands (S, N) [dB of 1 LSB^2 per sample], NaN where a line fills the band.

        Args:
            power: mean spectra (S, B) [LSB^2].
            line: of each station (S,) [Hz].
            count: of the sweeps in each mean (S,).
        """
        median, used = row_medians(self._beside(power, line))
        median = np.where(used >= SPECTRUM.fewest_bins, median, np.nan)
        return 10.0 * np.log10(median / (median_of_mean(count) * self._window_power)[:, None])

    def std(self, power: np.ndarray, line: np.ndarray, count: np.ndarray) -> np.ndarray:
        """Return the standard deviation of the noise in bands (S, N) [dB], infinite where a line fills the band.

        A median over bins whose expectation varies rests on those near it alone, and scatters the more.

        Args:
            power: mean spectra (S, B) [LSB^2].
            line: of each station (S,) [Hz].
            count: of the sweeps in each mean (S,).
        """
        std = np.full((len(power), SPECTRUM.bands), np.inf)
        inside = self._beside(power, line)
        enough = np.count_nonzero(~np.isnan(inside), axis=-1) >= SPECTRUM.fewest_bins
        for station, band in zip(*np.nonzero(enough), strict=True):
            values = inside[station, band]
            of_median = _std_of_median(values[~np.isnan(values)], float(count[station]))
            std[station, band] = 0.5 * DECIBELS_PER_NEPER * of_median
        return std

    def _beside(self, power: np.ndarray, line: np.ndarray) -> np.ndarray:
        """Return the power in the bins of each band, NaN at the lines and to make all bands as long (S, N, M)."""
        bins = power.shape[-1]
        edges = edges_of(bins)
        at = edges[:-1, None] + np.arange(np.diff(edges).max())
        inside = np.where(self.at_line(line, bins), np.nan, power)[:, np.minimum(at, bins - 1)]
        return np.where(at < edges[1:, None], inside, np.nan)

    def with_power(self, quiet: np.ndarray, power: np.ndarray) -> np.ndarray:
        """Return noise in bands (G, S, BANDS) [dB of 1 LSB^2 per sample] with smooth power added.

        Args:
            quiet: the same without it.
            power: in each bin (G, S, B) [LSB^2].
        """
        if not np.any(power):
            return quiet
        edges = edges_of(power.shape[-1])
        mean = np.add.reduceat(power, edges[:-1], axis=-1) / np.diff(edges) / self._window_power[:, None]
        total: np.ndarray = 10.0 * np.log10(10.0 ** (quiet / 10.0) + mean)
        return total

    def raised(self, quiet: np.ndarray, added: np.ndarray, line: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Return what the medians of bands show with lines added [dB of 1 LSB^2 per sample], and the noise in each bin.

        Args:
            quiet: noise in bands, of each group (G, S, N) [dB of 1 LSB^2 per sample].
            added: power of lines in each bin (G, S, B) [LSB^2].
            line: of each station (G, S) [Hz].
        """
        bins = added.shape[-1]
        edges = edges_of(bins)
        power = self._window_power[:, None]
        noise, floor = quiet.copy(), np.repeat(10.0 ** (quiet / 10.0) * power, np.diff(edges), axis=-1)
        noticed = np.maximum.reduceat(added / floor, edges[:-1], axis=-1) > SPECTRUM.noticed
        if noticed.any():
            shown = np.where(self.at_line(line, bins), np.nan, floor + added)
        for group, station, band in zip(*np.nonzero(noticed), strict=True):
            inside = shown[group, station, edges[band] : edges[band + 1]]
            if np.isfinite(inside).any():
                noise[group, station, band] = 10.0 * np.log10(np.nanmedian(inside) / power[station, 0])
        return noise, floor


def _std_of_median(power: np.ndarray, count: float) -> float:
    """Return the standard deviation of the logarithm of a median over bins, each a mean of `count` exponential powers.

    Of n bins with the distributions F, the median has the variance sum F (1 - F) / (sum F')^2. The logarithm of a mean
    is taken as normal, and its expectation as a parabola over the bins. Neighbouring bins of a Hann window share half
    of their noise.

    Args:
        power: of the bins (n,).
        count: of the powers in each mean.
    """
    parts = np.array([np.median(part) for part in np.array_split(power, SPECTRUM.band_parts)])
    least = np.finfo(float).tiny  # samples that are all zero have no noise
    place = (np.arange(len(parts)) + 0.5) / len(parts)
    course = np.polynomial.Polynomial.fit(place, np.log(np.maximum(parts, least)), 2)
    middle = np.log(max(float(np.median(power)), least))
    over = (middle - course(np.linspace(0.0, 1.0, SPECTRUM.band_places))) * np.sqrt(count)
    below = ndtr(over)
    density = np.sqrt(count / (2.0 * np.pi)) * np.mean(np.exp(-0.5 * over**2))
    if density < least:  # no bin is near the median: it says nothing
        return np.inf
    return float(np.sqrt(1.9 * np.mean(below * (1.0 - below)) / len(power)) / density)


def edges_of(bins: int) -> np.ndarray:
    """Return the first bin of each band and the end of the last, (N + 1,)."""
    return np.linspace(0, bins, SPECTRUM.bands + 1).astype(int)
