"""Judges a finding against the sealed truth: pure rules over two JSON objects."""

import collections
import dataclasses
import math
from collections.abc import Iterator, Mapping, Sequence
from typing import Any

OUTCOMES = ('right', 'undecided', 'unnamed', 'imitated', 'wrong', 'missed', 'failed')
"""What a finding can be worth.

right: the verdict and every effect with its station, or 'ambiguous' among what the data cannot separate; undecided:
the truth is among the explanations named, but the recording would have separated them; unnamed: an effect of the
registry was called unexplained; imitated: an unregistered effect that is indistinguishable from a registered one, so
that "unexplained" is impossible: neither right nor wrong; wrong: a name that is not the truth, or a mismatch where
there is none; missed: a mismatch called consistent; failed: no finding at all.
"""

TOLERATED_SHARE = 0.9
"""Of the excess misfit that levels which do hold a mismatch must have, for 'unexplained' to be no false alarm."""

SEPARABLE = 4.0
"""Standard deviations between what two explanations predict, below which they are one answer."""

Key = tuple[str, str | None]
Explained = frozenset[Key]


@dataclasses.dataclass(frozen=True)
class Pull:
    """One parameter of an effect that was named rightly."""

    effect: str
    parameter: str
    truth: float
    value: float
    std: float

    @property
    def pull(self) -> float:
        """Error in stated standard deviations."""
        return (self.value - self.truth) / self.std


@dataclasses.dataclass(frozen=True)
class Judgement:
    """What a finding is worth, and why."""

    outcome: str
    reason: str
    truth: Explained
    named: tuple[Explained, ...]  # explanations in the finding, the chosen one first
    pulls: tuple[Pull, ...] = ()
    apart: tuple[float | None, ...] = ()  # of each in `named`, see `judge`

    def as_object(self) -> dict[str, Any]:
        """Return a JSON-ready object."""
        return {
            'outcome': self.outcome,
            'reason': self.reason,
            'truth': words(self.truth),
            'named': [words(e) for e in self.named],
            'apart': list(self.apart),
            'pulls': [{**dataclasses.asdict(p), 'pull': p.pull} for p in self.pulls],
        }


def words(explanation: Explained) -> str:
    """Return an explanation as one text, such as 'spur (master) + echo'."""
    return ' + '.join(sorted(f'{e} ({s})' if s else e for e, s in explanation)) or 'nothing'


def keys(effects: Sequence[Mapping[str, Any]]) -> Explained:
    """Return effects with their stations, without sizes; further ones of a kind are numbered, such as 'echo 2'."""
    met: collections.Counter[tuple[str, str | None]] = collections.Counter()
    found = []
    for effect in effects:
        name, station = effect['effect'], effect['station']
        met[name, station] += 1
        number = met[name, station]
        found.append((name if number == 1 else f'{name} {number}', station))
    return frozenset(found)


def judge(truth: Mapping[str, Any], finding: Mapping[str, Any], apart: Sequence[float | None] = ()) -> Judgement:
    """Return how a finding compares with the truth.

    Args:
        truth: as sealed, see `proof.cases.Case.truth`.
        finding: as the tool wrote it, see `result.Diagnosis.as_object`.
        apart: distance of each explanation's data from the truth's, the chosen one first, in standard deviations as the
            generator computes them; None where it is not known.
    """
    wanted = keys(truth['effects'])
    named: tuple[Explained, ...] = ()
    if finding['effects']:
        named = keys(finding['effects']), *(keys(a['effects']) for a in finding['alternatives'])
    alike = {n for n, d in zip(named, apart, strict=False) if d is not None and d < SEPARABLE}
    alike = (alike | _rivals(truth)) - {wanted}
    outcome, reason = _outcome(truth, finding, wanted, named, alike)
    pulls: tuple[Pull, ...] = ()
    if named and named[0] == wanted:
        pulls = tuple(_pulls(truth['effects'], finding['effects']))
    return Judgement(outcome, reason, wanted, named, pulls, tuple(apart))


def _outcome(
    truth: Mapping[str, Any],
    finding: Mapping[str, Any],
    wanted: Explained,
    named: tuple[Explained, ...],
    alike: set[Explained],  # that the data cannot separate from the truth
) -> tuple[str, str]:
    verdict = finding['verdict']
    if not wanted:
        return _of_null(truth, finding, named)
    if verdict == 'consistent':
        return 'missed', 'called consistent'
    known = [e for e in truth['effects'] if e['registered'] and e['effect'] not in truth['without']]
    if verdict == 'partial':
        return _of_partial(keys(known), named[0], whole=len(known) == len(truth['effects']))
    if len(known) < len(truth['effects']):
        return _of_unregistered(truth, finding, keys(known), named, alike)
    if verdict == 'unexplained':
        return 'unnamed', 'in the registry, yet called unexplained'
    if verdict == 'explained':
        return _of_explained(truth, wanted, named[0], alike)
    return _of_ambiguous(truth, finding, wanted, named, alike)


def _of_partial(known: Explained, named: Explained, whole: bool) -> tuple[str, str]:
    """Return the outcome of effects named beside a remainder; `whole` if the registry has all that is concealed."""
    if not named <= known:
        return 'wrong', f'{_difference(named, known)}, beside a remainder'
    if named < known:
        return 'unnamed', 'named in part, beside a remainder'
    if whole:
        return 'unnamed', 'named, yet with a remainder that the registry explains'
    return 'right', 'named beside what the registry lacks'


def _of_unregistered(
    truth: Mapping[str, Any],
    finding: Mapping[str, Any],
    known: Explained,
    named: tuple[Explained, ...],
    alike: set[Explained],
) -> tuple[str, str]:
    verdict = finding['verdict']
    if verdict == 'unexplained':
        return ('unnamed', 'nothing named') if known else ('right', 'unexplained, as it should be')
    if known == named[0] and verdict == 'explained':
        return 'right', 'named, what the registry lacks is far smaller'
    if known in named and verdict == 'ambiguous':
        return 'right', 'named among others, beside what the registry lacks'
    if finding.get('remainder') and _in_part(truth, known, named):
        return 'unnamed', 'named in part, among others'
    if alike >= set(named):
        how = 'right' if _rivals(truth) & set(named) else 'imitated'
        return how, f'called {verdict} by an effect that the data cannot separate from the truth'
    return 'wrong', f'not in the registry, yet called {verdict}'


def _of_explained(
    truth: Mapping[str, Any], wanted: Explained, named: Explained, alike: set[Explained]
) -> tuple[str, str]:
    if named in alike:
        return 'wrong', 'one of several explanations that the data cannot separate, called the only one'
    if named != wanted:
        return 'wrong', _difference(named, wanted)
    if 'explained' not in truth['verdicts']:
        return 'wrong', 'the truth, but called the only explanation although the data allow others'
    return 'right', 'named'


def _in_part(truth: Mapping[str, Any], known: Explained, named: tuple[Explained, ...]) -> bool:
    """Return whether each explanation holds effects that are there, or some of a rival, and one nothing else."""
    every = [known, *_rivals(truth)]
    return any(e <= known for e in named) and all(any(e <= one for one in every) for e in named)


def _of_ambiguous(
    truth: Mapping[str, Any],
    finding: Mapping[str, Any],
    wanted: Explained,
    named: tuple[Explained, ...],
    alike: set[Explained],
) -> tuple[str, str]:
    if wanted not in named and finding.get('remainder') and _in_part(truth, wanted, named):
        return 'unnamed', 'named in part, among others'
    if wanted not in named:
        return 'wrong', 'ambiguous, the truth not among the explanations'
    if _rivals(truth) & set(named):
        return 'right', 'ambiguous, the truth and its rivals named'
    if 'explained' not in truth['verdicts']:
        return 'wrong', 'ambiguous, none of the true rivals among the explanations'
    if alike >= set(named) - {wanted}:
        return 'right', 'ambiguous, the truth among explanations that the data cannot separate'
    return 'undecided', 'ambiguous, the truth among the explanations'


def _rivals(truth: Mapping[str, Any]) -> set[Explained]:
    return {keys(rival) for rival in truth['rivals']}


def _of_null(truth: Mapping[str, Any], finding: Mapping[str, Any], named: tuple[Explained, ...]) -> tuple[str, str]:
    verdict = finding['verdict']
    if verdict == 'consistent':
        return 'right', 'consistent'
    if verdict == 'unexplained':
        tolerated = (x['share'] for x in finding['locations'] if x['level'] in truth['tolerated_levels'])
        if sum(tolerated) >= TOLERATED_SHARE:
            return 'right', 'unexplained at a level that does hold a mismatch'
    elif all(effect in truth['tolerated'] for effect, _ in named[0]):
        return 'right', 'named a mismatch that the recording does hold'
    return 'wrong', f'false alarm: {verdict}'


def _difference(found: Explained, wanted: Explained) -> str:
    if sorted(e for e, _ in found) == sorted(e for e, _ in wanted):
        return 'wrong station'
    if found < wanted:
        return 'named only a part'
    if found > wanted:
        return 'named more than there is'
    return 'wrong name'


def _pulls(truths: Sequence[Mapping[str, Any]], found: Sequence[Mapping[str, Any]]) -> Iterator[Pull]:
    """Yield the parameters that truth and finding both state; phases are left out, they give the sign of a size."""
    for truth in truths:
        alike = [f for f in found if (f['effect'], f['station']) == (truth['effect'], truth['station'])]
        same = min(alike, key=lambda f: _distance(truth['parameters'], f['parameters']))
        unsigned = 'phase' in same['parameters']
        for name, value in truth['parameters'].items():
            several = value if isinstance(value, list) else None
            if several and f'{name}[{len(several)}]' in same['parameters']:
                continue  # another number of coefficients: each means something else
            for index, true in enumerate(several or [value]):
                stated = same['parameters'].get(f'{name}[{index}]' if several else name)
                if name == 'phase' or not stated or not stated['value'] or not stated['std']:
                    continue
                is_level = stated['unit'].startswith('dB')  # no phase gives its sign
                estimate = abs(stated['value']) if unsigned and not is_level else stated['value']
                if math.isfinite(true):
                    yield Pull(truth['effect'], name, float(true), estimate, stated['std'])


def _distance(true: Mapping[str, Any], stated: Mapping[str, Any]) -> float:
    """Return the sum of the relative differences of the parameters that both state."""
    shared = [(v, stated[n]['value']) for n, v in true.items() if n in stated and not isinstance(v, list)]
    return sum(abs(a - b) / max(abs(a), abs(b), 1e-30) for a, b in shared)
