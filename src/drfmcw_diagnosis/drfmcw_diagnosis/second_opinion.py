"""What the proof's generator says of a finding: how far from the truth its explanations are, and what would decide."""

from collections.abc import Callable, Mapping, Sequence
from typing import Any

import numpy as np

from .judging import keys
from .proof.carried_out import Carried, carried_out
from .proof.effects import Applied
from .proof.generator import Condition
from .proof.sizes import separation

_IMPOSSIBLE = (ArithmeticError, TypeError, ValueError, np.linalg.LinAlgError)  # parameters without a recording
_HOPELESS = 10.0  # standard deviations, which no refit brings below those that count as one answer

_ROUNDS = 2  # of all parameters: they are not independent

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


def parted(condition: Condition, truth: Effects, finding: Mapping[str, Any]) -> list[float | None] | None:
    """Return by how much the recommended measurement, carried out, parts the truth from each explanation.

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
    """Return the distance after each parameter in turn was moved to where it is smallest, a parabola by its deviation.

    The explanation was fitted to the noise too: by so much its data differ even where it acts as the truth does.
    """
    best = [{**e, 'parameters': dict(e['parameters'])} for e in explanation]
    for effect in best * _ROUNDS:
        for name, stated in list(effect['parameters'].items()):
            if not stated['std'] or '[' in name:  # values per setting are many
                continue

            def moved(step: float, effect: Any = effect, name: str = name, stated: Any = stated) -> float:
                effect['parameters'][name] = {**stated, 'value': stated['value'] + step * stated['std']}
                return to_truth(best)

            less, more = moved(-1.0), moved(1.0)
            curvature = less**2 + more**2 - 2.0 * found**2
            step = float(np.clip(0.5 * (less**2 - more**2) / curvature, -4.0, 4.0)) if curvature > 0.0 else 0.0
            there = moved(step)
            if there < found:
                found = there
            else:
                effect['parameters'][name] = stated
    return found


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
