"""What the challenge conceals: nulls, single effects by size, pairs, what no registry knows, decoys, degenerate sets.

Strong effects are as practice recordings hold them; effects left out are in the registry, but the tool
searches without them. Each ambiguous case of the full list is followed by the measurement that decides it.

`plans` lists cases without computing anything but their random conditions; `conceal_case` scales a case's effects,
seals its truth and writes its recording. Everything follows from the seed.
"""

import dataclasses
import hashlib
import itertools
from collections.abc import Callable, Iterator, Sequence
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from ..generator.condition import Condition
from ..generator.model import nominal
from ..generator.phase_noise import NoiseShape
from ..generator.recordings import Seal, seal, write_recording
from .concealing import KINDS, OUTSIDE, REGISTERED, Applied, conceal
from .covering import covering
from .decoys import DECOYS
from .draws import (
    TWINS,
    Extent,
    Rival,
    both_stations,
    floats,
    other_station,
    possible,
    random_condition,
    random_extent,
    rivals,
    substitutes,
    template,
    velocities,
)
from .sizes import MatchedSize, matched_size, scaled

GROUPS: dict[str, int] = {
    'null': 5,
    'single': 6,
    'strong': 3,
    'pair': 2,
    'strong_pair': 2,
    'mixture': 3,
    'beside_unknown': 2,
    'outside': 2,
    'decoy': 1,
    'ambiguous': 1,
    'decided': 0,
    'left_out': 2,
}
"""Groups of cases, and their shares where only some cases are run; 'decided' follows what it decides."""


@dataclasses.dataclass(frozen=True)
class Wanted:
    """An effect to be concealed: as it is given, or scaled to a matched signal-to-noise `d`."""

    template: Applied
    d: float | None = None


@dataclasses.dataclass(frozen=True)
class Plan:
    """One case before its effects are scaled."""

    name: str  # reveals nothing
    group: str
    kind: str  # within the group, for tables
    condition: Condition
    wanted: tuple[Wanted, ...] = ()
    verdicts: tuple[str, ...] = ('consistent',)  # that are right
    rivals: tuple[Rival, ...] = ()  # explanations that are indistinguishable from the truth
    tolerated: tuple[str, ...] = ()  # effects whose finding is no false alarm: the recording does hold such a mismatch
    tolerated_levels: tuple[str, ...] = ()  # at which 'unexplained' is none either
    without: tuple[str, ...] = ()  # effects that the tool leaves out of its search
    follows: 'Plan | None' = None  # the ambiguous case that this measurement decides, by the same effects
    gone: bool = False  # where the effects are no longer there in the measurement that follows


@dataclasses.dataclass(frozen=True)
class Case:
    """A case with its effects at their final sizes."""

    plan: Plan
    effects: tuple[Applied, ...]
    sizes: tuple[MatchedSize, ...]  # of each effect, the earlier ones in place
    alone: tuple[float, ...]  # d of each effect, no other one in place
    beside: tuple[float, ...]  # d of each effect, all others in place

    def truth(self) -> dict[str, Any]:
        """Return what is sealed. The salt keeps anyone from confirming a guessed truth by its hash."""
        plan = self.plan
        return {
            'name': plan.name,
            'group': plan.group,
            'kind': plan.kind,
            'verdicts': list(plan.verdicts),
            'effects': [
                {
                    **effect.as_object(),
                    'units': dict(KINDS[effect.effect].units),
                    'registered': KINDS[effect.effect].registered,
                    'd': {**size.as_object(), 'alone': alone, 'beside': beside},
                }
                for effect, size, alone, beside in zip(self.effects, self.sizes, self.alone, self.beside, strict=True)
            ],
            'rivals': [[{'effect': e, 'station': s} for e, s in rival] for rival in plan.rivals],
            'tolerated': list(plan.tolerated),
            'tolerated_levels': list(plan.tolerated_levels),
            'without': list(plan.without),
            'follows': plan.follows.name if plan.follows else None,
            'condition': dataclasses.asdict(plan.condition),
            'salt': hashlib.sha256(f'{plan.condition.seed}/{plan.name}'.encode()).hexdigest(),
        }


def realise(plan: Plan) -> Case:
    """Scale the effects of a plan."""
    effects: list[Applied] = []
    sizes: list[MatchedSize] = []
    all_wanted = plan.wanted
    if plan.follows is not None and not plan.gone:
        all_wanted = tuple(Wanted(effect) for effect in realise(plan.follows).effects)
    for wanted in all_wanted:
        # an effect of the reference's time shows only where the crane moves: those before it are in place
        if wanted.d is None:
            size = matched_size(plan.condition, [wanted.template], effects)
            effect = wanted.template
        else:
            effect, size = scaled(plan.condition, wanted.template, wanted.d, effects)
        effects.append(effect)
        sizes.append(size)
    totals = [size.total for size in sizes]  # of the first one that by itself, of the last one that beside all others
    alone = totals[:1] + [matched_size(plan.condition, [effect]).total for effect in effects[1:]]
    beside = [
        matched_size(plan.condition, [effect], effects[:i] + effects[i + 1 :]).total
        for i, effect in enumerate(effects[:-1])
    ] + totals[-1:]
    return Case(_possible(plan, effects), tuple(effects), tuple(sizes), tuple(alone), tuple(beside))


def _possible(plan: Plan, effects: Sequence[Applied]) -> Plan:
    """Return a plan without the rivals that effects of these sizes cannot have."""
    alike = possible(plan.rivals, effects)
    if alike == plan.rivals:
        return plan
    others = tuple(v for v in plan.verdicts if v != 'ambiguous')
    verdicts = (*(others or ('explained',)), *(('ambiguous',) if alike else ()))
    return dataclasses.replace(plan, rivals=alike, verdicts=verdicts)


def conceal_case(
    plan: Plan,
    recordings: Path | str,
    truths: Path | str,
    announce: Callable[[Plan, Seal], None] | None = None,
) -> tuple[Path, Seal]:
    """Seal a case's truth, announce the seal, then write its recording; return the recording's path and the seal.

    Args:
        plan: what to conceal.
        recordings: folder of the recordings, all that the tool sees.
        truths: folder of the sealed truths, another one.
        announce: called with the seal before the recording exists.

    Raises:
        BagError: the recording exists already or cannot be written.
        ValueError: recordings and truths in the same folder.
    """
    if Path(recordings).resolve() == Path(truths).resolve():
        raise ValueError(f'{truths}: truths must not lie beside the recordings')
    case = realise(plan)
    sealed = seal(case.truth(), Path(truths) / f'{plan.name}.json')
    if announce is not None:
        announce(plan, sealed)
    path = Path(recordings) / plan.name
    write_recording(conceal(nominal(plan.condition), case.effects), path)
    return path, sealed


# --- single effects ---

_FIXED = ('stuck_bit', 'missing_codes', 'dropped_samples', 'sporadic_drop')  # come in whole numbers


def _single(
    name: str, random: np.random.Generator, effect: str, d: float | None, extent: Extent, group: str = 'single'
) -> Plan:
    condition = random_condition(random, extent)
    if effect in ('clipping', 'compression', 'second_order_distortion', 'missing_codes'):
        condition = dataclasses.replace(condition, full_scale_power=-35.0)  # a receiver that uses its range
    parts = template(random, effect, condition)
    wanted = [Wanted(p) for p in parts[:-1]] + [Wanted(parts[-1], None if effect in _FIXED else d)]
    alike = rivals(condition, parts)
    if group == 'outside':
        verdicts: tuple[str, ...] = ('unexplained',)
    elif effect in TWINS:
        verdicts = ('ambiguous',)
    else:
        verdicts = ('explained', 'ambiguous') if alike else ('explained',)
    return Plan(name, group, effect, condition, tuple(wanted), verdicts, alike)


def _left_out(name: str, random: np.random.Generator, effect: str, d: float, extent: Extent) -> Plan:
    """Return a case of an effect that the tool does not know: nothing but a twin may be named."""
    plan = _single(name, random, effect, d, extent, 'left_out')
    alike = substitutes(plan.condition, effect)
    verdicts = ('unexplained', 'explained', 'ambiguous') if alike else ('unexplained',)
    return dataclasses.replace(plan, verdicts=verdicts, rivals=alike, without=(effect,))


# --- nulls ---

NULLS = ('right', 'corner', 'flank', 'bump', 'plateau', 'outliers', 'drift')
"""Kinds of null recordings."""


def _null(name: str, random: np.random.Generator, kind: str, extent: Extent) -> Plan:
    condition = random_condition(random, extent)
    tolerated: tuple[str, ...] = ()
    levels: tuple[str, ...] = ()
    if kind == 'outliers':
        condition = dataclasses.replace(condition, outlier_probability=0.03)
        tolerated, levels = ('noise_floor', 'interference_burst', 'amplitude_loss'), ('noise', 'amplitude')
    elif kind == 'drift':
        condition = dataclasses.replace(condition, amplitude_drift=float(random.uniform(0.1, 0.4)))
        tolerated, levels = ('amplitude_loss',), ('amplitude',)
    elif kind != 'right':
        value = {
            'corner': float(random.choice([0.4, 0.6, 1.6, 2.5])),
            'flank': float(random.uniform(8e3, 3e4)),
            'bump': float(random.uniform(3.0, 8.0)),
            'plateau': float(random.choice([-2.0, -1.0, 1.0, 2.0])),
        }[kind]
        condition = both_stations(condition, shape=NoiseShape(kind, value))
        tolerated, levels = ('phase_noise',), ('noise', 'if_spectrum')
    return Plan(name, 'null', kind, condition, (), ('consistent',), (), tolerated, levels)


# --- decoys ---


def _decoy(name: str, random: np.random.Generator, kind: str, d: float, extent: Extent) -> Plan:
    condition, effects = DECOYS[kind](random, extent)
    parts = tuple(part for effect in effects for part in template(random, effect, condition))
    verdicts = ('explained',) if parts else ('consistent',)
    return Plan(name, 'decoy', kind, condition, tuple(Wanted(p, d) for p in parts), verdicts)


# --- ambiguous by construction ---


def _warming(condition: Condition) -> Condition:
    """Return the condition with boards that warm steadily from the calibration temperature on."""
    n = len(condition.distances)
    warm = floats(25.0 + 12.0 * np.arange(n) / max(n - 1, 1))
    return dataclasses.replace(condition, board_temperature=(warm, warm))


_CLOCK_BY = 'clock by time or temperature'
_DELAY_BY = 'delay by either board'


def _ambiguous(name: str, random: np.random.Generator, kind: str, d: float, extent: Extent) -> Plan:
    condition = random_condition(random, extent)
    if kind in TWINS or kind == 'reference_clock_offset':
        (part,) = template(random, kind, condition)
        alike = rivals(condition, (part,))
    elif kind in (_CLOCK_BY, _DELAY_BY):
        condition = _warming(condition)
        station = condition.names[int(random.integers(2))]
        other = other_station(condition, station)
        if kind == _DELAY_BY:
            part = Applied('delay_temperature', station, {'slope': 1.0})
            alike = ((('delay_temperature', other),),)
        else:
            part = Applied('reference_clock_temperature', station, {'slope': 0.1})
            alike = tuple(
                ((effect, where),)
                for effect in ('reference_clock_temperature', 'reference_clock_drift')
                for where in (station, other)
                if (effect, where) != (part.effect, station)
            )
    else:
        raise ValueError(f"no ambiguous case '{kind}'")
    return Plan(name, 'ambiguous', kind, condition, (Wanted(part, d),), ('ambiguous',), alike)


AMBIGUOUS = (*sorted(TWINS), 'reference_clock_offset', _CLOCK_BY, _DELAY_BY)
"""Kinds of cases that one recording cannot decide."""

_OF_REFERENCE = ('reference_lag', 'reference_offset', 'reference_scale')


def decided(name: str, plan: Plan) -> Plan:
    """Return the measurement that decides an ambiguous case, and what it should find.

    Where boards warm steadily, one in which they wander. Where the reference instrument may be wrong, one with an
    instrument that has been checked, searched without its effects: what is left is the path's, nothing if it was the
    instrument's. Where either reference oscillator may be wrong, one after the first station's has been counted and
    calibrated.
    """
    before, effect = plan.condition, plan.wanted[0].template
    condition = dataclasses.replace(before, seed=before.seed + 1)
    without: tuple[str, ...] = ()
    alike: tuple[Rival, ...] = ()
    gone = False
    if plan.kind in TWINS:
        kind, without = 'reference instrument checked', _OF_REFERENCE
        gone = effect.effect in _OF_REFERENCE
    elif plan.kind == 'reference_clock_offset':
        kind = 'reference of the first station counted'
        gone = effect.station == before.names[0]
        alike = () if gone else plan.rivals  # the tool does not know that this station is counted
    else:
        kind = 'boards at other temperatures'
        random = np.random.Generator(np.random.PCG64(before.seed))
        boards = [floats(random.uniform(10.0, 40.0, len(before.distances))) for _ in range(2)]
        condition = dataclasses.replace(condition, board_temperature=(boards[0], boards[1]))
    verdicts: tuple[str, ...] = ('consistent',) if gone else ('explained', 'ambiguous') if alike else ('explained',)
    return Plan(name, 'decided', kind, condition, (), verdicts, alike, without=without, follows=plan, gone=gone)


# --- lists ---


@dataclasses.dataclass(frozen=True)
class Counts:
    """How many cases of each group, before they are multiplied by `times`."""

    nulls: int = 60  # with the right noise
    wrong_nulls: int = 10  # of each other kind
    sizes: tuple[float, ...] = (5.0, 7.0, 9.0, 12.0, 18.0)  # d of single effects, each of each
    strong_sizes: tuple[float, ...] = (60.0, 250.0)  # d of effects as in the practice recordings, each of each
    drives: int = 4
    pairs: int = 24  # of d from 12 to 25
    strong_pairs: int = 20  # of d from 50 to 500
    mixtures: int | None = None  # of two to four effects of d from 8 to 3000; None: as many as cover all pairs
    beside_unknown: int = 30  # the same of one or two, beside something outside the registry
    outside_sizes: tuple[float, ...] = (16.0, 100.0)
    decoys: int = 1  # of each kind
    ambiguous: int = 2  # of each kind, each with the measurement that decides it
    left_out_sizes: tuple[float, ...] = (40.0,)
    times: int = 1


FULL = Counts()
"""Of the full proof: what two cores do in some hours."""

# a cubic spline of the rate holds a parabola of the frequency
_PAIRS_NEVER = frozenset(frozenset(pair) for pair in (*TWINS.items(), ('sweep_shape', 'sweep_curvature')))


def plans(extent: str = 'full', seed: int = 1, counts: Counts = FULL) -> tuple[Plan, ...]:
    """Return the cases of a proof.

    Args:
        extent: 'quick', a dozen of 10 x 8 sweeps, or 'full', of 14 x 24.
        seed: from which everything follows.
        counts: of the full list.

    Raises:
        ValueError: another extent.
    """
    if extent not in ('quick', 'full'):
        raise ValueError(f"no list of cases '{extent}'")
    listed = list(_quick() if extent == 'quick' else _full(counts))
    sequences = np.random.SeedSequence([seed, len(listed)]).spawn(len(listed))
    planned = [
        build(_name(number), np.random.Generator(np.random.PCG64(sequence)))
        for number, (build, sequence) in enumerate(zip(listed, sequences, strict=True))
    ]
    if extent == 'full':
        ambiguous = [plan for plan in planned if plan.group == 'ambiguous']
        planned += [decided(_name(number), plan) for number, plan in enumerate(ambiguous, len(planned))]
    return tuple(planned)


def _name(number: int) -> str:
    return f'recording_{number:04d}'


Builder = Callable[[str, np.random.Generator], Plan]


def _quick() -> Iterator[Builder]:
    small = Extent(10, 8)
    for kind in ('right', 'bump'):
        yield partial(_null, kind=kind, extent=small)
    for effect in ('sweep_ripple', 'echo', 'reference_clock_temperature', 'spur', 'delay_temperature', 'noise_floor'):
        yield partial(_single, effect=effect, d=16.0, extent=small)
    yield partial(_pair, effects=('pll_settling', 'tx_leakage'), d=16.0, extent=small)
    yield partial(_single, effect='phase_jump', d=20.0, extent=small, group='outside')
    yield partial(_ambiguous, kind='delay_offset', d=12.0, extent=small)
    yield partial(_left_out, effect='echo', d=40.0, extent=small)


def _full(counts: Counts) -> Iterator[Builder]:
    for _ in range(counts.times):
        yield from map(_anywhere, _once(counts))


def _anywhere(build: Callable[..., Plan]) -> Builder:
    """Return a builder of a case at a random site, by a random schedule."""
    return lambda name, random: build(name, random, extent=random_extent(random))


def _once(counts: Counts) -> Iterator[Callable[..., Plan]]:
    nulls = {kind: counts.nulls if kind == 'right' else counts.wrong_nulls for kind in NULLS}
    yield from (partial(_null, kind=kind) for kind, count in nulls.items() for _ in range(count))
    for effect in REGISTERED:
        yield from (partial(_single, effect=effect, d=d) for d in counts.sizes)
        yield from (partial(_single, effect=effect, d=d, group='strong') for d in counts.strong_sizes)
        yield from (partial(_left_out, effect=effect, d=d) for d in counts.left_out_sizes)
    yield from itertools.repeat(_drive, counts.drives)
    yield from itertools.repeat(partial(_pair, effects=None, d=None), counts.pairs)
    yield from itertools.repeat(_strong_pair, counts.strong_pairs)
    for effects in covering(REGISTERED, _PAIRS_NEVER)[: counts.mixtures]:
        yield partial(_mixture, effects=effects)
    yield from itertools.repeat(_beside_unknown, counts.beside_unknown)
    for effect in OUTSIDE:
        yield from (partial(_single, effect=effect, d=d, group='outside') for d in counts.outside_sizes)
    for kind in DECOYS:
        yield from itertools.repeat(partial(_decoy, kind=kind, d=14.0), counts.decoys)
    for kind in AMBIGUOUS:
        yield from itertools.repeat(partial(_ambiguous, kind=kind, d=14.0), counts.ambiguous)


def _two(random: np.random.Generator) -> tuple[str, str]:
    """Return two effects that are not degenerate."""
    while True:
        drawn = random.choice([e for e in REGISTERED if e != 'reference_lag'], 2, replace=False)
        if frozenset(map(str, drawn)) not in _PAIRS_NEVER:
            return str(drawn[0]), str(drawn[1])


def _pair(
    name: str, random: np.random.Generator, effects: tuple[str, str] | None, d: float | None, extent: Extent
) -> Plan:
    """Return a case of two effects, None draws them; of d from 12 to 25 where none is given."""
    condition = random_condition(random, extent)
    effects = effects or _two(random)
    parts = tuple(part for effect in effects for part in template(random, effect, condition))
    wanted = tuple(Wanted(part, random.uniform(12.0, 25.0) if d is None else d) for part in parts)
    return _of_pair(name, 'pair', condition, wanted)


def _strong_pair(name: str, random: np.random.Generator, extent: Extent) -> Plan:
    """Return a case of two strong effects; a crane that moves drives at its own speed."""
    condition = random_condition(random, extent)
    parts = [part for effect in _two(random) for part in template(random, effect, condition)]
    sizes = np.exp(random.uniform(np.log(50.0), np.log(500.0), len(parts)))
    wanted = [
        Wanted(part, None if part.effect == 'target_motion' else float(d)) for part, d in zip(parts, sizes, strict=True)
    ]
    wanted.sort(key=lambda w: w.d is not None)  # an effect is scaled while the crane drives
    return _of_pair(name, 'strong_pair', condition, tuple(wanted))


_MIXED = (8.0, 3000.0)
"""Least and largest d of an effect in a mixture."""


def _mixture(name: str, random: np.random.Generator, effects: Sequence[str], extent: Extent) -> Plan:
    """Return a case of several effects, each of any size."""
    condition = random_condition(random, extent)
    return _of_pair(name, 'mixture', condition, _mixed(random, effects, condition))


def _beside_unknown(name: str, random: np.random.Generator, extent: Extent) -> Plan:
    """Return a case of one or two effects and something that the registry lacks."""
    condition = random_condition(random, extent)
    known = _two(random)[: int(random.integers(1, 3))]
    wanted = _mixed(random, known, condition)
    unknown = str(random.choice(OUTSIDE))
    parts = template(random, unknown, condition)
    wanted += tuple(Wanted(part, None if unknown in _FIXED else _any_size(random)) for part in parts)
    plan = _of_pair(name, 'beside_unknown', condition, wanted)
    alike = rivals(condition, [w.template for w in wanted if KINDS[w.template.effect].registered])
    return dataclasses.replace(plan, verdicts=('partial', 'ambiguous') if alike else ('partial',), rivals=alike)


def _mixed(random: np.random.Generator, effects: Sequence[str], condition: Condition) -> tuple[Wanted, ...]:
    """Return effects of random shape and size; a crane that moves drives at its own speed."""
    parts = [part for effect in effects for part in template(random, effect, condition)]
    once = {part.effect: part for part in parts}  # a crane drives once
    wanted = [Wanted(part, None if part.effect == 'target_motion' else _any_size(random)) for part in once.values()]
    return tuple(sorted(wanted, key=lambda w: w.d is not None))  # an effect is scaled while the crane drives


def _any_size(random: np.random.Generator) -> float:
    return float(np.exp(random.uniform(*np.log(_MIXED))))


def _of_pair(name: str, group: str, condition: Condition, wanted: tuple[Wanted, ...]) -> Plan:
    parts = [w.template for w in wanted]
    alike = rivals(condition, parts)
    # a ray from the ground follows the true distance, so that it may reveal an error of the reference
    exact = any(part.effect in TWINS for part in parts) and all(part.effect != 'ground_reflection' for part in parts)
    verdicts: tuple[str, ...] = ('explained',)
    if alike:
        verdicts = ('ambiguous',) if exact else ('explained', 'ambiguous')
    return Plan(name, group, ' + '.join(sorted(p.effect for p in parts)), condition, wanted, verdicts, alike)


def _drive(name: str, random: np.random.Generator, extent: Extent) -> Plan:
    """Return a case of a crane that drives at its own speed."""
    condition = random_condition(random, extent)
    part = Applied('target_motion', None, {'velocity': velocities(random, len(condition.distances))})
    return Plan(name, 'strong', 'target_motion', condition, (Wanted(part),), ('explained',))
