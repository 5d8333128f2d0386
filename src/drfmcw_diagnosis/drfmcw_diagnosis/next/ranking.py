"""Which measurement would decide between explanations that fit a recording alike.

Each hypothetical measurement is simulated under every explanation with the registry's forward models: instruments read
the state that an effect changes; further sweeps are synthesised and compared like a recording. The rival's parameters
are fitted again (linearly, about its fit) to recording and measurement together. The squared separation is the squared
distance between chosen and rival explanation that then remains, less that over the recording alone. A rival that can
follow the measurement is not separated.
"""

import dataclasses
import math
from collections.abc import Callable, Iterator, Sequence

import numpy as np

from drfmcw_physics.settings import declared_parameters

from ..finding.result import NextMeasurement
from ..search.fits.fitted import Fitted
from ..search.fits.fitting import Fitting
from .further_sweeps import Baseline, Between, Exchanged, FurtherAway, MoreSweeps, OtherStartDelay, Repeated
from .instruments import (
    DrivePast,
    Effects,
    FrequencyCounter,
    Measurement,
    PhaseNoiseMeter,
    SecondInstrument,
    TerminatedAntenna,
)
from .limits import FURTHER


def measurements(stations: Sequence[str]) -> Iterator[Measurement]:
    """Yield all measurements that are simulated."""
    yield from (FrequencyCounter('alpha'), FrequencyCounter('sample_clock'))
    yield from (FrequencyCounter('alpha', warmer=15.0), FrequencyCounter('alpha', later=3600.0))
    yield from (PhaseNoiseMeter(), TerminatedAntenna(), SecondInstrument(), DrivePast())
    yield from (Baseline(5.0), Baseline(15.0), OtherStartDelay(), FurtherAway(), Between(), MoreSweeps())
    yield Repeated('when air and boards are 15 K warmer', board=15.0, air=15.0)
    for station in stations:
        alone = ', the other one not' if len(stations) > 1 else ''
        yield Repeated(f'with the board of {station} heated by 15 K{alone}', board=15.0, station=station)
    yield Repeated('an hour later at the same temperatures, the power left on', later=3600.0)
    yield Repeated('with attenuators of 10 dB before the receivers', attenuation=10.0)
    yield Repeated('with the crane braked, in calm air', still=True)
    yield from map(Exchanged, stations)


@dataclasses.dataclass(frozen=True)
class _Prediction:
    """What one explanation predicts, in standard deviations."""

    value: np.ndarray  # (n,)
    slope: np.ndarray  # (n, parameters) by each parameter

    def weighted(self, weight: np.ndarray) -> '_Prediction':
        """Return the same with every number weighted."""
        return _Prediction(self.value * weight, self.slope * weight[:, None])


def _predicted(fitted: Fitted, show: Callable[[Effects], np.ndarray]) -> _Prediction:
    """Return what is shown under an explanation, and its derivatives by all of its fitted parameters."""
    value = show(tuple(e.build() for e in fitted.effects))
    slopes = []
    for number, effect in enumerate(fitted.effects):
        for name in effect.candidate.free:
            declared = declared_parameters(effect.candidate.kind)[name.partition('[')[0]][1]
            step = effect.candidate.recipe.step(name, effect.values[name])
            if declared.bounds and effect.values[name] + step > declared.bounds[1]:
                step = -step
            moved = effect.candidate.build(effect.values | {name: effect.values[name] + step})
            effects = tuple(moved if i == number else e.build() for i, e in enumerate(fitted.effects))
            slopes.append((show(effects) - value) / step)
    return _Prediction(value, np.reshape(slopes, (len(slopes), len(value))).T)


def _condensed(chosen: _Prediction, rival: _Prediction) -> np.ndarray:
    """Return the rival's slopes and the difference as columns of fewer rows with the same inner products."""
    return np.asarray(np.linalg.qr(np.column_stack([rival.slope, chosen.value - rival.value]), mode='r'))


def _misfit(condensed: np.ndarray) -> float:
    """Return the smallest sum of squares of the difference that the rival's parameters leave."""
    slope, difference = condensed[:, :-1], condensed[:, -1]
    size = np.linalg.norm(slope, axis=0)
    scaled = slope[:, size > 0.0] / size[size > 0.0]
    if not scaled.shape[1]:
        return float(difference @ difference)
    left = difference - scaled @ np.linalg.lstsq(scaled, difference, rcond=1e-9)[0]
    return float(left @ left)


def ranked(
    fitting: Fitting,
    chosen: Fitted,
    rivals: Sequence[Fitted],
    candidates: Sequence[Measurement] | None = None,
) -> tuple[NextMeasurement, ...]:
    """Return what each measurement would decide, the most decisive first.

    Args:
        fitting: of the recording, which says how far the forward models are trusted.
        chosen: explanation that is taken for true.
        rivals: those to be ruled out.
        candidates: measurements to simulate, None for all.
    """
    comparison = fitting.comparison
    chosen, *rivals = explanations = _without_shared([chosen, *rivals])
    recorded = _trusted([_predicted(f, comparison.template) for f in explanations], fitting, chosen)
    alone = [_condensed(recorded[0], r) for r in recorded[1:]]
    count = int(np.clip(FURTHER.predicted / sum(map(_cost, explanations)), 2, FURTHER.distances))
    kinds = {e.candidate.kind for f in explanations for e in f.effects}
    found = []
    for measurement in candidates or measurements(comparison.data.stations):
        view = measurement.view(comparison, count) if all(map(measurement.predictable, kinds)) else None
        if view is None:
            continue
        shown = [_predicted(f, view.show) for f in explanations]
        if view.comparison is not None:
            shown = _trusted(shown, Fitting(view.comparison), chosen)
        both = [np.concatenate([r, _condensed(shown[0], s)]) for r, s in zip(alone, shown[1:], strict=True)]
        gains = [max(_misfit(b) - _misfit(r), 0.0) for r, b in zip(alone, both, strict=True)]
        found.append(NextMeasurement(measurement.sentence, tuple(map(math.sqrt, gains))))
    return tuple(sorted(found, key=lambda m: (-m.decides, -round(m.separation, 3))))


def _without_shared(explanations: list[Fitted]) -> list[Fitted]:
    """Return explanations without the distortions and bursts of all of them, which take long and decide nothing."""

    def acting(fitted: Fitted) -> set[tuple[str, str]]:
        return {e.key for e in fitted.effects if e.candidate.acts}

    shared = set.intersection(*map(acting, explanations))
    kept = [tuple(e for e in f.effects if e.key not in shared) for f in explanations]
    if not all(kept):
        return explanations
    return [dataclasses.replace(f, effects=effects) for f, effects in zip(explanations, kept, strict=True)]


def _cost(fitted: Fitted) -> int:
    """Return the effort of predicting an explanation and its derivatives at one distance."""
    predictions = 1 + sum(len(e.candidate.free) for e in fitted.effects)
    distorting = any(e.candidate.kind.distorts for e in fitted.effects)
    return predictions * (FURTHER.distorting if distorting else 1)


def _trusted(shown: list[_Prediction], fitting: Fitting, chosen: Fitted) -> list[_Prediction]:
    """Return predictions weighted by how far the forward models are trusted."""
    doubt = fitting.doubt(dataclasses.replace(chosen, template=shown[0].value))
    return [p.weighted(1.0 / np.sqrt(1.0 + doubt**2)) for p in shown]
