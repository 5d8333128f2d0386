"""Noise in bands of equal width beside the lines: what a spectrum shows of it, and what further lines make of that."""

from collections.abc import Sequence

import numpy as np

from .limits import SPECTRUM
from .spectra import median_of_mean, near_line


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

    def measured(self, power: np.ndarray, line: np.ndarray, count: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Return the noise in bands and its standard deviation, (S, N) each [dB of 1 LSB^2 per sample].

        NaN and an infinite standard deviation where a line fills the band.

        Args:
            power: mean spectra (S, B) [LSB^2].
            line: of each station (S,) [Hz].
            count: of the sweeps in each mean (S,).
        """
        bins = power.shape[-1]
        masked = self.at_line(line, bins)
        noise, std = (np.full((len(power), SPECTRUM.bands), value) for value in (np.nan, np.inf))
        edges = edges_of(bins)
        for station in range(len(power)):
            for band in range(SPECTRUM.bands):
                inside = power[station, edges[band] : edges[band + 1]]
                inside = inside[~masked[station, edges[band] : edges[band + 1]]]
                if len(inside) < SPECTRUM.fewest_bins:
                    continue
                median = np.median(inside) / median_of_mean(count[station])
                noise[station, band] = 10.0 * np.log10(median / self._window_power[station])
                # neighbouring bins of a Hann window share half of their noise; a median has 1.25 times the mean's
                std[station, band] = 4.34 * 1.25 * np.sqrt(1.9 / (len(inside) * count[station]))
        return noise, std

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


def edges_of(bins: int) -> np.ndarray:
    """Return the first bin of each band and the end of the last, (N + 1,)."""
    return np.linspace(0, bins, SPECTRUM.bands + 1).astype(int)
