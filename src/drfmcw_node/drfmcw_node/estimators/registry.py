"""The selectable estimators of a station's beat frequency."""

import functools

from drfmcw_physics.oscillators import Calibration
from drfmcw_physics.sweep import SweepSettings

from .estimation import ESTIMATORS, Estimator, EstimatorSettings


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


def estimator_table() -> str:
    """Return a Markdown table of the estimators: name, what it does, and whether it takes a window."""
    rows = ['| estimator | how it finds the line | window |', '|---|---|---|']
    for name, cls in ESTIMATORS.items():
        summary = (cls.__doc__ or '').partition('\n')[0]
        rows.append(f'| `{name}` | {summary} | {"as set" if cls.takes_window else "its own"} |')
    return '\n'.join(rows)
