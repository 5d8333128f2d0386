"""Accuracy over distances, modes, reference differences and noise floors, against the Cramer-Rao bound."""

import concurrent.futures
import math
import multiprocessing
from pathlib import Path

import numpy as np
import scipy.fft
from figures import Figure
from rich.console import Console
from rich.progress import track
from rich.table import Table

from drfmcw_fusion.offline import replay_recording
from drfmcw_fusion.replayed.statistics import setting_statistics
from drfmcw_node.estimators.estimation import EstimatorSettings
from drfmcw_node.estimators.registry import estimator
from drfmcw_physics.bounds import outlier_probability
from drfmcw_physics.sweep import SweepSettings
from drfmcw_study.accuracy import Accuracy, Cell, grid, left_out

_ESTIMATORS = 'ml', 'pair'
_TRIALS = 20000  # per cell in a run of a minute or more: chi-square then has a standard error of 1 %
_LINES = 20000  # for the outliers
_RECORDING = Path(__file__).parents[1] / 'test' / 'data' / 'recording_0'


def _measured(task: tuple[Cell, str, int]) -> Accuracy:
    """Return one cell with one estimator; 20 000 sweep pairs take 160 MB."""
    cell, name, trials = task
    return cell.measure(name, range(trials))


def _grid(trials: int, console: Console) -> dict[str, dict[Cell, Accuracy]]:
    """Return all cells by estimator, from all cores."""
    tasks = [(cell, name, trials) for cell in grid() for name in _ESTIMATORS]
    results: dict[str, dict[Cell, Accuracy]] = {name: {} for name in _ESTIMATORS}
    with concurrent.futures.ProcessPoolExecutor(mp_context=multiprocessing.get_context('spawn')) as pool:
        done = track(pool.map(_measured, tasks), 'accuracy', len(tasks), console=console, transient=True)
        for (cell, name, _), accuracy in zip(tasks, done, strict=True):
            results[name][cell] = accuracy
    return results


def _cells(results: dict[str, dict[Cell, Accuracy]]) -> Table:
    """Return a table of all cells."""
    table = Table(
        'cell', 'estimator', 'bound [mm]', 'std [mm]', 'ratio', 'bias [mm]', 'chi-square/n', 'carrier [mm]', 'ratio'
    )
    for name, cells in results.items():
        for cell, a in cells.items():
            table.add_row(
                str(cell), name, f'{1e3 * a.bound:.3f}', f'{1e3 * a.std:.3f}', f'{a.std / a.bound:.3f}',
                f'{1e3 * a.bias:+.3f}', f'{a.chi_square:.3f}', f'{1e3 * a.carrier_std:.4f}',
                f'{a.carrier_std / a.carrier_bound:.3f}',
            )  # fmt: skip
    return table


def _outliers() -> tuple[float, float]:
    """Return the share of lines of 13 dB per bin that `ml` and a finely searched periodogram miss by 2 bins."""
    sweep = SweepSettings('first', 'second')
    rng = np.random.default_rng(1)
    t = np.arange(sweep.sample_count) / sweep.sample_rate
    window = slice(*(round(x * sweep.sample_rate) for x in sweep.analysis_window()))
    estimate = estimator(sweep, EstimatorSettings(estimator='ml'))
    sigma = math.sqrt(sweep.sample_count / 4 / 10**1.3)
    ours = reference = 0
    for _ in range(_LINES // 500):
        frequency = rng.uniform(30e3, 990e3, 500)
        line = np.cos(2 * np.pi * frequency[:, None] * t + rng.uniform(0, 2 * np.pi, (500, 1)))
        samples = np.round(100 * (line + sigma * rng.normal(size=line.shape))).astype(np.int16)
        ours += int(np.count_nonzero(np.abs(estimate(samples, 8192.0).frequency - frequency) > 2000.0))
        power = np.abs(scipy.fft.rfft(samples[:, window].astype(np.float32), 8 * sweep.sample_count)) ** 2
        found = (power[:, 64 : 8 * 1016].argmax(axis=1) + 64) * (sweep.sample_rate / 8 / sweep.sample_count)
        reference += int(np.count_nonzero(np.abs(found - frequency) > 2000.0))
    return ours / _LINES, reference / _LINES


def _recorded(name: str) -> tuple[float, float]:
    """Return the standard deviation beyond 900 m in a recording not made by this code, and as predicted [mm].

    The instrument that gave the reference contributes to both.
    """
    replay = replay_recording(str(_RECORDING), EstimatorSettings(estimator=name))
    rows = [r for r in setting_statistics(replay.results, replay.reference) if (r.reference or 0.0) > 900.0]
    predicted = [r.range_std**2 + (r.reference_std or 0.0) ** 2 for r in rows]
    return 1e3 * math.sqrt(np.mean([r.std**2 for r in rows])), 1e3 * math.sqrt(np.mean(predicted))


def bench_accuracy(seconds: float, console: Console) -> list[Figure]:
    """Measure bias, standard deviation and reported standard deviation of `ml` and `pair`; outliers; a recording."""
    trials = max(round(_TRIALS * min(seconds / 60.0, 1.0)), 100)
    results = _grid(trials, console)
    console.print(_cells(results))
    console.print(
        f'{trials} trials a cell; left out, as a line leaves the band or the mode does not fit the distance: '
        + ', '.join(left_out()),
        highlight=False,
    )
    figures = []
    for name, cells in results.items():
        values = cells.values()
        ratio = max(cells, key=lambda c: cells[c].std / cells[c].bound)
        chi = max(cells, key=lambda c: abs(cells[c].chi_square - 1.0))
        figures += [
            Figure(f'{name}: largest standard deviation over its bound ({ratio})',
                   cells[ratio].std / cells[ratio].bound, '', 1.05, bound=1.0),
            Figure(f'{name}: largest bias over standard deviation', max(abs(a.bias) / a.std for a in values), '', 0.2),
            Figure(f'{name}: largest bias', 1e3 * max(abs(a.bias) for a in values), 'mm', 0.3),
            Figure(f'{name}: largest error of reported variance ({chi})', abs(cells[chi].chi_square - 1.0), '', 0.05),
            Figure(f'{name}: largest standard deviation of carrier phase over its bound',
                   max(a.carrier_std / a.carrier_bound for a in values), bound=1.0),
        ]  # fmt: skip
    ours, reference = _outliers()
    figures.append(
        Figure('ml: lines of 13 dB per bin missed (goal: as the periodogram, two standard errors)', ours, '',
               reference + 2.0 * math.sqrt(reference / _LINES), bound=outlier_probability(10**1.3, 1008),
               reference=reference, reference_name='periodogram, 1/8 bin')
    )  # fmt: skip
    paper, _ = _recorded('paper')
    for name in _ESTIMATORS:
        recorded, predicted = _recorded(name)
        figures.append(
            Figure(f'recording_0 beyond 900 m, {name}', recorded, 'mm', 10.8, bound=predicted, reference=paper,
                   reference_name="the paper's estimator")
        )  # fmt: skip
    return figures
