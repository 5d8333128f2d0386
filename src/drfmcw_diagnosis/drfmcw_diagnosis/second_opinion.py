"""What the proof's generator says of a finding: how far from the truth its explanations are, and what would decide."""

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from .judging import keys
from .proof.carried_out import carried_out
from .proof.effects import Applied
from .proof.generator import Condition
from .proof.sizes import separation

_IMPOSSIBLE = (ArithmeticError, TypeError, ValueError, np.linalg.LinAlgError)  # parameters without a recording

Effects = Sequence[Mapping[str, Any]]


def apart(condition: Condition, truth: Effects, finding: Mapping[str, Any]) -> list[float | None]:
    """Return how far from the data of the truth those of each explanation in a finding are, the chosen one first.

    None for the truth, however well it is fitted, and where an explanation's parameters allow no recording.
    """
    return [_apart(lambda one, other: separation(condition, one, other), truth, e) for e in explanations(finding)]


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


def _apart(measure: Any, truth: Effects, explanation: Effects) -> float | None:
    if not truth or keys(truth) == keys(explanation):
        return None
    there = [Applied(e['effect'], e['station'], e['parameters']) for e in truth]
    try:
        with np.errstate(all='ignore'):
            found = float(measure([_as_concealed(e) for e in explanation], there))
    except _IMPOSSIBLE:
        return None
    return found if np.isfinite(found) else None


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
