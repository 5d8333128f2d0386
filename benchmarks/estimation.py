"""Speed of the estimators on simulated sweeps, beside NumPy, SciPy and scikit-radar doing the same in the same run."""

from collections.abc import Callable
from typing import Any

import numpy as np
import references
from figures import Figure
from measuring import rates
from rich.console import Console

from drfmcw_node.estimators.estimation import Estimates, EstimatorSettings
from drfmcw_physics.bounds import additive_factor
from drfmcw_physics.sweep import Mode
from drfmcw_sim.measurements import Measurements
from drfmcw_sim.scenario import Scenario
from drfmcw_sim.synthesis.signal_model import synthesise
from drfmcw_study.accuracy import Cell
from drfmcw_study.measurement import conditions, station_estimates

_SWEEPS = 512
_TRIALS = 4000  # for the standard deviation, 1.1 % of standard error
_GOALS = {('hann', 0.0): 50e3, ('hann', 20.0): 30e3, ('ml', 0.0): 10e3, ('ml', 20.0): 10e3}
_PAIRS = 6000.0


class _Material:
    """Simulated sweeps of one condition, and functions that estimate them."""

    def __init__(self, difference: float) -> None:
        """Simulate sweeps at 200 m with references `difference` ppm apart."""
        self.cell = Cell('B', 200.0, Mode.SHORT_DISTANCE, difference)
        self.scenario: Scenario = self.cell.scenario()
        self.m: Measurements = conditions(self.scenario, range(_SWEEPS), self.cell.mode)
        self.samples = synthesise(self.m, self.scenario.seed)
        self.rate = self.m.stations[0].sweep.sample_rate

    def estimates(self, name: str) -> tuple[Estimates, ...]:
        """Return what an estimator makes of both stations' sweeps."""
        return station_estimates(self.scenario, self.m, self.samples, EstimatorSettings(estimator=name))

    def sweeps(self, name: str) -> Callable[[], int]:
        """Return a function that estimates both stations' sweeps, one by one."""

        def work() -> int:
            self.estimates(name)
            return 2 * _SWEEPS

        return work

    def pairs(self) -> Callable[[], int]:
        """Return a function that estimates both stations' sweeps jointly."""

        def work() -> int:
            self.estimates('pair')
            return _SWEEPS

        return work


def bench_estimation(seconds: float, console: Console) -> list[Figure]:
    """Measure sweeps per second of each estimator, references equal and 20 ppm apart, and pairs per second."""
    material = {difference: _Material(difference) for difference in (0.0, 20.0)}
    equal = material[0.0]
    jobs = {f'{name} {d:g}': material[d].sweeps(name) for name in ('paper', 'hann', 'ml') for d in material}
    jobs |= {f'pair {d:g}': material[d].pairs() for d in material}
    first, second = equal.samples

    def reference(function: Callable[..., Any], *arrays: np.ndarray, **keywords: Any) -> Callable[[], int]:
        def work() -> int:
            function(*arrays, **keywords)
            return len(arrays[0])

        return work

    jobs['zoom'] = reference(references.frequency_by_zoom_fft, first[:64], sample_rate=equal.rate)
    jobs['matrix'] = reference(references.frequency_by_matrix, first, sample_rate=equal.rate)
    jobs['product'] = reference(references.beat_sum_by_product, first, second, sample_rate=equal.rate, sign=-1)
    jobs['rfft'] = reference(references.bare_rfft, first)
    try:
        references.scikit_radar()
        jobs['scikit-radar'] = reference(references.frequency_by_scikit_radar, first[:64], sample_rate=equal.rate)
    except ImportError as error:
        console.print(f'left out: {error}', style='yellow')
    rate = rates(jobs, seconds, console, 'estimation')
    compared = {
        'paper': ('zoom', 'SciPy zoom_fft'),
        'hann': ('matrix', 'NumPy zoom by matrix'),
        'ml': ('scikit-radar', 'scikit-radar') if 'scikit-radar' in rate else ('zoom', 'SciPy zoom_fft'),
        'pair': ('product', 'NumPy product of both IFs'),
    }
    figures = []
    for name in ('paper', 'hann', 'ml', 'pair'):
        key, title = compared[name]
        for difference in material:
            goal = _PAIRS if name == 'pair' else _GOALS.get((name, difference))
            figures.append(
                Figure(f'estimation: {name}, references {difference:g} ppm apart', rate[f'{name} {difference:g}'],
                       'pairs/s' if name == 'pair' else 'sweeps/s', goal, '>=',
                       bound=rate['rfft'] / 2 if name == 'pair' else rate['rfft'],
                       reference=rate[key], reference_name=title)
            )  # fmt: skip
    for difference, condition in material.items():
        found = condition.cell.measure('hann', range(_TRIALS))
        figures.append(
            Figure(f'hann: standard deviation over the bound, {difference:g} ppm apart', found.std / found.bound, '',
                   1.6, bound=additive_factor('hann') / additive_factor('boxcar'))
        )  # fmt: skip
    return figures
