"""What the proof's generator says of a finding: how far from the truth its explanations are, and what would decide."""

import itertools
import math
from collections.abc import Callable, Mapping, Sequence
from typing import Any

import numpy as np

from .cases.carried_out import Carried, carried_out
from .cases.concealing import Applied
from .cases.sizes import separation
from .generator.condition import Condition
from .judging import keys

_IMPOSSIBLE = (ArithmeticError, TypeError, ValueError, np.linalg.LinAlgError)  # parameters without a recording
_HOPELESS = 10.0  # standard deviations, which no refit brings below those that count as one answer

_SHARES = (1.0, 0.5, 0.25)  # of a step towards the truth that are tried
_FLAT = 1e-6  # of the largest curvature, below which a direction is left alone

Effects = Sequence[Mapping[str, Any]]


def apart(condition: Condition, truth: Effects, finding: Mapping[str, Any]) -> list[float | None]:
    """Return how far from the data of the truth those of each explanation in a finding are, the chosen one first.

    Parameters are moved to where they are nearest to the truth. None for the truth itself, however well it is fitted,
    and where the parameters allow no recording.
    """
    return [
        _apart(lambda one, other: separation(condition, one, other), truth, e, refit=True)
        for e in explanations(finding)
    ]


def separated(condition: Condition, truth: Effects, finding: Mapping[str, Any]) -> list[float | None] | None:
    """Return by how much the recommended measurement, when carried out, separates the truth from each explanation.

    As `apart`; None altogether where nothing is recommended, or nothing that the generator can make.
    """
    recommended = finding['next_measurement']
    measure = carried_out(recommended, condition) if recommended else None
    if measure is None:
        return None
    return [_apart(measure, truth, e) for e in explanations(finding)]


def explanations(finding: Mapping[str, Any]) -> list[Effects]:
    """Return the explanations of a finding, the chosen one first."""
    return [finding['effects'], *(a['effects'] for a in finding['alternatives'])] if finding['effects'] else []


def _apart(measure: Carried, truth: Effects, explanation: Effects, refit: bool = False) -> float | None:
    if not truth or keys(truth) == keys(explanation):
        return None
    there = [Applied(e['effect'], e['station'], e['parameters']) for e in truth]

    def to_truth(values: Effects) -> float:
        try:
            with np.errstate(all='ignore'):
                return float(measure([_as_concealed(e) for e in values], there))
        except _IMPOSSIBLE:
            return np.nan

    found = to_truth(explanation)
    if refit and found < _HOPELESS:
        found = _nearest(to_truth, explanation, found)
    return found if np.isfinite(found) else None


def _nearest(to_truth: Callable[[Effects], float], explanation: Effects, found: float) -> float:
    """Return the distance after all parameters were moved to where it is smallest: one Newton's step on its square.

    The explanation was fitted to the noise too: by so much its data differ even where it acts as the truth does.
    Differences over the stated standard deviations give slopes and curvatures, of every two parameters together.
    """
    entries = [
        (number, name)
        for number, effect in enumerate(explanation)
        for name, stated in effect['parameters'].items()
        if stated['std'] and '[' not in name  # values per setting are many
    ]
    count = len(entries)

    def square(moves: np.ndarray) -> float:
        there = [{**e, 'parameters': dict(e['parameters'])} for e in explanation]
        for (number, name), move in zip(entries, moves, strict=True):
            stated = explanation[number]['parameters'][name]
            there[number]['parameters'][name] = {**stated, 'value': stated['value'] + move * stated['std']}
        return to_truth(there) ** 2

    unit = np.eye(count)
    more, less = (np.array([square(sign * u) for u in unit]) for sign in (1.0, -1.0))
    curvature = np.diag(more + less - 2.0 * found**2)
    for i, j in itertools.combinations(range(count), 2):
        curvature[i, j] = curvature[j, i] = square(unit[i] + unit[j]) - more[i] - more[j] + found**2
    if not np.all(np.isfinite(curvature)):
        return found
    values, axes = np.linalg.eigh(curvature)
    sound = values > _FLAT * max(values.max(initial=0.0), 0.0)
    step = -axes[:, sound] @ (axes[:, sound].T @ (0.5 * (more - less)) / values[sound])
    tried = [math.sqrt(square(share * step)) for share in _SHARES]
    return min([found, *(one for one in tried if np.isfinite(one))])


def _as_concealed(effect: Mapping[str, Any]) -> Applied:
    """Return an effect of a finding as the generator takes it."""
    parameters: dict[str, Any] = {}
    for name, stated in effect['parameters'].items():
        base, bracket, _ = name.partition('[')
        if bracket:
            parameters.setdefault(base, []).append(stated['value'])
        else:
            parameters[base] = stated['value']
    return Applied(effect['effect'], effect['station'], parameters)
