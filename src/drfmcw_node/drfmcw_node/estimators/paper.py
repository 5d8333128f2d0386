"""The paper's on-board engine: FFT, chirp-z zoom, parabola."""

from typing import Any

import numpy as np

from .estimation import TINY, Estimator, Sweeps
from .spectral import ChirpZ, parabola_value, parabola_vertex


class PaperEstimator(Estimator, name='paper'):
    """FFT, chirp-z zoom, parabola through the log magnitude: the paper's on-board engine (section III)."""

    takes_window = True
    chunk = 1 << 16  # the zoom's factors are twice as large as a sweep

    def __init__(self, *args: Any, **kwargs: Any) -> None:
        """Prepare the chirp-z transform; arguments as for `Estimator`."""
        super().__init__(*args, **kwargs)
        self._zoom = ChirpZ(
            self.sweep.sample_count,
            self.length,
            self.settings.zoom_points,
            self.settings.zoom_span,
            self.center * self.sweep.sample_rate,
        )

    def _refine(self, sweeps: Sweeps) -> tuple[np.ndarray, np.ndarray]:
        peak = sweeps.peak
        zoomed = self._zoom(sweeps.windowed, peak)
        offsets = self._zoom.offsets
        magnitude = zoomed.real**2 + zoomed.imag**2
        top = np.minimum(np.maximum(magnitude.argmax(axis=1), 1), len(offsets) - 2)
        three = np.arange(len(peak)), top + np.array([[-1], [0], [1]])
        vertex = parabola_vertex(*np.log(np.maximum(magnitude[three], TINY)))
        left, middle, right = zoomed[three]
        amplitude = parabola_value(left, middle, right, vertex)
        return peak + offsets[top] + vertex * (offsets[1] - offsets[0]), amplitude
