"""The selectable estimators of a station's beat frequency."""

import functools

from drfmcw_physics.oscillators import Calibration
from drfmcw_physics.sweep import SweepSettings

from .estimation import Estimator, EstimatorSettings
from .hann import HannEstimator
from .maximum_likelihood import MaximumLikelihoodEstimator
from .paper import PaperEstimator

ESTIMATORS: dict[str, type[Estimator]] = {
    'paper': PaperEstimator,
    'hann': HannEstimator,
    'ml': MaximumLikelihoodEstimator,
    'pair': MaximumLikelihoodEstimator,  # of a sweep without its partner; with it: pair.pair_estimator
}
"""Estimators by the name that `EstimatorSettings.estimator` selects."""


@functools.lru_cache(maxsize=64)
def estimator(
    sweep: SweepSettings,
    settings: EstimatorSettings,
    iq: bool = False,
    own: Calibration | None = None,
    peer: Calibration | None = None,
) -> Estimator:
    """Return the estimator chosen in `settings`, prepared for one setting; arguments as for `Estimator`."""
    return ESTIMATORS[settings.estimator](sweep, settings, iq, own, peer)
