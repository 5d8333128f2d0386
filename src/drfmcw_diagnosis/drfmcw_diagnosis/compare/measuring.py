"""What kinds of numbers measure together: spectra of each group's sweeps, their noise, and how sweeps scatter."""

import functools

import numpy as np

from ..features.extractor import ramp_spectrum
from ..features.spectra import local_noise, median_of_mean
from .known import Known
from .recorded_sweeps import RecordedSweeps


class Evidence:
    """What the sweeps of a recording's G groups show; S stations with samples.

    Attributes:
        recorded: the sweeps and their features.
        known: what is known to expect of them.
        counts: sweeps of each group (G,).
        roots: their square roots (G,).
        calm_roots: square roots of how many of them hold no burst (G,), see `RecordedSweeps.calm`.
    """

    def __init__(self, recorded: RecordedSweeps, known: Known) -> None:
        """Take sweeps, and what is known of them."""
        self.recorded, self.known = recorded, known
        self.counts = np.array([len(m) for m in recorded.members])
        self.roots = np.sqrt(self.counts)
        self.calm_roots = np.sqrt([calm.sum() for calm in recorded.calm])

    def mean(self, feature: str) -> np.ndarray:
        """Return the mean over each group's sweeps of a field of `SweepFeatures` (G, ...)."""
        return np.stack([getattr(s, feature).mean(axis=0) for s in self.recorded.sweeps])

    def of_calm(self, feature: str) -> list[np.ndarray]:
        """Return a field of `SweepFeatures` of each group's sweeps without a burst (n, ...)."""
        pairs = zip(self.recorded.sweeps, self.recorded.calm, strict=True)
        return [getattr(sweeps, feature)[calm] for sweeps, calm in pairs]

    def samples(self, group: int) -> list[np.ndarray]:
        """Return a group's samples of each station with samples (n, N), with iq (n, 2 N) [LSB]."""
        data, rows = self.recorded.data, self.recorded.members[group]
        return [data.samples_of(i)[rows] for i in self.recorded.heard]

    @functools.cached_property
    def ramps(self) -> list[np.ndarray]:
        """Cosine series of each group's sweeps (n, 2 S, K)."""
        return [ramp_spectrum(s.ramp) for s in self.recorded.sweeps]

    @functools.cached_property
    def around(self) -> np.ndarray:
        """Noise around each bin of the spectra (G, S, B) [LSB^2]."""
        pairs = zip(self.recorded.spectra, self.recorded.quiet_counts, strict=True)
        return np.stack([local_noise(power) / median_of_mean(count)[:, None] for power, count in pairs])

    @functools.cached_property
    def noise(self) -> tuple[np.ndarray, np.ndarray]:
        """Noise in bands [dB of 1 LSB^2 per sample] and its standard deviation, (G, S, N) each."""
        r = self.recorded
        groups = zip(r.spectra, r.sweeps, r.quiet_counts, strict=True)
        found = [(power, sweeps.line.mean(axis=0), count) for power, sweeps, count in groups]
        return np.stack([r.bands.measured(*of) for of in found]), np.stack([r.bands.std(*of) for of in found])

    @functools.cached_property
    def white(self) -> list[dict[str, np.ndarray]]:
        """Variances that additive noise alone makes of one sweep of each group, by feature: `Extractor.white_noise`."""
        density = 10.0 ** (np.nanmedian(self.noise[0], axis=2) / 10.0)
        extract = self.recorded.parts[0].extract
        return [extract.white_noise(s, d) for s, d in zip(self.recorded.sweeps, density, strict=True)]

    @functools.cached_property
    def range_errors(self) -> list[np.ndarray]:
        """Ranges less the reference's, of each group's sweeps (n,) [m]."""
        return [self.recorded.range_error(g) for g in range(len(self.counts))]
