"""What the challenge conceals: nulls, single effects by size, pairs, what no registry knows, decoys, degenerate sets.

`plans` lists cases without computing anything but their random conditions; `conceal_case` scales a case's effects,
seals its truth and writes its recording. Everything follows from the seed.
"""

import dataclasses
import hashlib
from collections.abc import Callable, Iterator
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from .effects import KINDS, OUTSIDE, REGISTERED, Applied, conceal
from .generator import Condition, NoiseShape, StationCondition, nominal
from .recordings import Seal, seal, write_recording
from .sizes import MatchedSize, matched_size, scaled

GROUPS = ('null', 'single', 'pair', 'outside', 'decoy', 'ambiguous')

Rival = tuple[tuple[str, str | None], ...]
"""Another explanation: effects with their stations."""


@dataclasses.dataclass(frozen=True)
class Wanted:
    """An effect to be concealed: as it is given, or scaled to a matched signal-to-noise `d`."""

    template: Applied
    d: float | None = None


@dataclasses.dataclass(frozen=True)
class Plan:
    """One case before its effects are scaled."""

    name: str  # tells nothing
    group: str
    kind: str  # within the group, for tables
    condition: Condition
    wanted: tuple[Wanted, ...] = ()
    verdicts: tuple[str, ...] = ('consistent',)  # that are right
    rivals: tuple[Rival, ...] = ()  # explanations that the data cannot tell from the truth
    tolerated: tuple[str, ...] = ()  # effects whose finding is no false alarm: the recording does hold such a mismatch
    tolerated_levels: tuple[str, ...] = ()  # at which 'unexplained' is none either


@dataclasses.dataclass(frozen=True)
class Case:
    """A case with its effects at their final sizes."""

    plan: Plan
    effects: tuple[Applied, ...]
    sizes: tuple[MatchedSize, ...]  # of each effect alone, the earlier ones in place

    def truth(self) -> dict[str, Any]:
        """Return what is sealed. The salt keeps the hash of a guessed truth from telling that it is right."""
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
                    'd': size.as_object(),
                }
                for effect, size in zip(self.effects, self.sizes, strict=True)
            ],
            'rivals': [[{'effect': e, 'station': s} for e, s in rival] for rival in plan.rivals],
            'tolerated': list(plan.tolerated),
            'tolerated_levels': list(plan.tolerated_levels),
            'condition': dataclasses.asdict(plan.condition),
            'salt': hashlib.sha256(f'{plan.condition.seed}/{plan.name}'.encode()).hexdigest(),
        }


def realise(plan: Plan) -> Case:
    """Scale the effects of a plan."""
    effects: list[Applied] = []
    sizes: list[MatchedSize] = []
    for wanted in plan.wanted:
        # an effect of the reference's time shows only where the crane moves: those before it are in place
        if wanted.d is None:
            size = matched_size(plan.condition, [wanted.template], effects)
            effect = wanted.template
        else:
            effect, size = scaled(plan.condition, wanted.template, wanted.d, effects)
        effects.append(effect)
        sizes.append(size)
    return Case(plan, tuple(effects), tuple(sizes))


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


# --- conditions ---


@dataclasses.dataclass(frozen=True)
class Extent:
    """How large recordings are."""

    settings: int = 14
    sweeps: int = 24


def random_condition(random: np.random.Generator, extent: Extent, **changes: Any) -> Condition:
    """Return a condition like those of the practice recordings: every number varies, the layout is theirs."""
    n = extent.settings
    fixed = np.array([38, 75, 111, 157, 230, 307, 402, 501, 598, 680, 760, 852, 931, 1001], float)
    places = np.interp(np.linspace(0.0, 13.0, n), np.arange(14.0), fixed)
    air = random.uniform(5.0, 25.0, n)
    boards = [air + random.uniform(5.0, 15.0, n) for _ in range(2)]
    calibrated = random.random() < 0.5
    stations = []
    for name, delay in ('master', 12e-9), ('slave', 15e-9):
        alpha = 1.0 + 1e-6 * random.uniform(-8.0, 8.0) * calibrated
        stations.append(
            StationCondition(
                name,
                delay=delay if random.random() < 0.5 else random.uniform(8e-9, 25e-9),
                alpha=alpha,
                sample_clock_alpha=alpha * (1.0 + 1e-6 * random.uniform(-2.0, 2.0) * calibrated),
                calibration_temperature=25.0,
                noise_floor=float(random.choice([-142.0, -140.0, -140.0, -137.0])),
                phase_noise_level=float(random.choice([-92.0, -90.0, -90.0, -88.0])),
                phase_noise_corner=float(random.choice([90e3, 120e3, 120e3, 160e3])),
            )
        )
    condition = Condition(
        seed=int(random.integers(2**62)),
        distances=_floats(places + random.uniform(-4.0, 4.0, n)),
        air_temperature=_floats(air),
        air_pressure=_floats(random.uniform(99e3, 104e3, n)),
        air_humidity=_floats(random.uniform(0.1, 0.9, n)),
        board_temperature=(_floats(boards[0]), _floats(boards[1])),
        stations=(stations[0], stations[1]),
        sweeps=extent.sweeps,
    )
    return dataclasses.replace(condition, **changes)


def _floats(values: np.ndarray) -> tuple[float, ...]:
    return tuple(float(v) for v in values)


def _stations(condition: Condition, **changes: Any) -> Condition:
    """Return the condition with both stations changed alike."""
    first, second = (dataclasses.replace(s, **changes) for s in condition.stations)
    return dataclasses.replace(condition, stations=(first, second))


# --- effects ---


def template(random: np.random.Generator, effect: str, condition: Condition) -> tuple[Applied, ...]:
    """Return an effect of random shape and side, to be scaled; those that show it come before it."""
    station = condition.names[int(random.integers(2))] if KINDS[effect].of == 'station' else None
    sign = float(random.choice([-1.0, 1.0]))
    n, uniform = len(condition.distances), random.uniform

    def between(low: float, high: float) -> float:
        """Return a number of uniform logarithm."""
        return float(np.exp(uniform(np.log(low), np.log(high))))

    shapes: dict[str, Callable[[], dict[str, Any]]] = {
        'reference_clock_offset': lambda: {'deviation': sign},
        'reference_clock_temperature': lambda: {'slope': sign},
        'reference_clock_drift': lambda: (
            {'rate': sign} if uniform() < 0.5 else {'warmup': sign, 'time_constant': between(100.0, 400.0)}
        ),
        'sample_clock_offset': lambda: {'deviation': sign},
        'air_refractivity': lambda: {'offset': sign},
        'delay_offset': lambda: {'delay': sign},
        'delay_temperature': lambda: {'slope': sign},
        'ground_reflection': lambda: {'height_product': between(30.0, 200.0), 'coefficient': sign},
        'echo': lambda: {
            'excess_range': between(3.0, 40.0),
            'relative_power': -50.0,
            'phase': float(uniform(0.0, 6.28)),
        },
        'tx_leakage': lambda: {'level': -85.0},
        'spur': lambda: {'frequency': float(uniform(5e4, 9.5e5)), 'level': -90.0},
        'sweep_curvature': lambda: {'deviation': sign},
        'sweep_ripple': lambda: {'deviation': 1.0, 'rate': between(4e3, 4e4), 'phase': float(uniform(0.0, 6.28))},
        'pll_settling': lambda: {
            'step': sign,
            'natural_frequency': between(8e3, 4e4),
            'damping': float(uniform(0.2, 0.7)),
        },
        'phase_noise': lambda: {'level': -90.0},
        'noise_floor': lambda: {'excess': 1.0},
        'amplitude_loss': lambda: {'loss': 1.0} if uniform() < 0.5 else {'specific': 1.0},
        'target_motion': lambda: {'velocity': _velocities(random, n)},
        'sway': lambda: {'amplitude': 1.0, 'frequency': float(uniform(0.2, 0.9))},
        'slant_geometry': lambda: {'height_difference': 1.0},
        'clipping': lambda: {'level': -25.0},
        'compression': lambda: {'third_order': sign},
        'if_filter': lambda: {'pole': 1e6},
        'interference_burst': lambda: {
            'probability': float(uniform(0.05, 0.3)),
            'level': -62.0,
            'duration': between(2e-5, 2e-4),
        },
        'reference_lag': lambda: {'lag': 1.0},
        'reference_offset': lambda: {'offset': sign},
        'reference_scale': lambda: {'scale': sign},
        'stuck_bit': lambda: {'bit': int(random.integers(3, 7)), 'value': int(random.integers(2))},
        'missing_codes': lambda: {'width': int(random.choice([8, 16, 32, 64]))},
        'gain_step': lambda: {'step': sign, 'time': float(uniform(2e-4, 8e-4))},
        'phase_jump': lambda: {'angle': sign, 'time': float(uniform(2e-4, 8e-4))},
        'frequency_step': lambda: {
            'step': sign,
            'temperature': float(np.median(condition.board_temperature[condition.names.index(str(station))])),
        },
        'fan_modulation': lambda: {'depth': 1.0, 'rate': between(3e3, 3e4), 'duty': float(uniform(0.1, 0.5))},
        'second_harmonic': lambda: {'second_order': sign},
        'delay_hysteresis': lambda: {'slope': sign, 'time_constant': between(40.0, 200.0)},
        'adc_dither': lambda: {'amplitude': 1.0, 'period': float(uniform(5.0, 40.0))},
        'dropped_samples': lambda: {'count': int(random.integers(1, 4)), 'time': float(uniform(2e-4, 8e-4))},
        'frequency_glitch': lambda: {'peak': sign, 'time': float(uniform(2e-4, 8e-4)), 'width': between(5e-6, 5e-5)},
        'interleaving': lambda: {'skew': 1.0, 'period': int(random.choice([4, 8]))},
    }
    applied = Applied(effect, station, shapes[effect]())
    if effect == 'reference_lag':  # a late reference is right where nothing moves
        return Applied('target_motion', None, {'velocity': _velocities(random, n)}), applied
    return (applied,)


def _velocities(random: np.random.Generator, n: int) -> list[float]:
    """Return velocities of both signs, one for each setting [m/s]."""
    return [float(v) for v in random.choice([-1.0, 1.0], n) * random.uniform(0.2, 1.7, n)]


_TWINS: dict[str, str] = {
    'delay_offset': 'reference_offset',
    'reference_offset': 'delay_offset',
    'air_refractivity': 'reference_scale',
    'reference_scale': 'air_refractivity',
}
"""Effects that change the data alike."""


def _other(condition: Condition, station: str | None) -> str:
    return condition.names[1 - condition.names.index(str(station))]


def _rivals(condition: Condition, effects: tuple[Applied, ...]) -> tuple[Rival, ...]:
    """Return what changes the data as a single effect does, whatever its size."""
    if len(effects) > 1:
        return ()
    effect, station = effects[0].effect, effects[0].station
    if effect in _TWINS:
        return (((_TWINS[effect], None),),)
    if effect in (
        'reference_clock_offset',
        'reference_clock_drift',
    ):  # an IF knows the difference of the references only, but for 1e-6 of it
        return (((effect, _other(condition, station)),),)
    return ()


_FIXED = ('stuck_bit', 'missing_codes', 'dropped_samples')  # come in whole numbers


def _single(
    name: str, random: np.random.Generator, effect: str, d: float, extent: Extent, group: str = 'single'
) -> Plan:
    condition = random_condition(random, extent)
    if effect in ('clipping', 'compression', 'second_harmonic', 'missing_codes'):
        condition = dataclasses.replace(condition, full_scale_power=-35.0)  # a receiver that uses its range
    parts = template(random, effect, condition)
    wanted = [Wanted(p) for p in parts[:-1]] + [Wanted(parts[-1], None if effect in _FIXED else d)]
    rivals = _rivals(condition, parts)
    if group == 'outside':
        verdicts: tuple[str, ...] = ('unexplained',)
    else:
        verdicts = ('explained', 'ambiguous') if rivals else ('explained',)
    return Plan(name, group, effect, condition, tuple(wanted), verdicts, rivals)


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
        condition = _stations(condition, shape=NoiseShape(kind, value))
        tolerated, levels = ('phase_noise',), ('noise', 'if_spectrum')
    return Plan(name, 'null', kind, condition, (), ('consistent',), (), tolerated, levels)


# --- decoys: what looks like a cause and is none ---


def _decoy_hot_null(random: np.random.Generator, extent: Extent) -> tuple[Condition, tuple[str, ...]]:
    """Boards that follow the distance, and nothing else."""
    condition = random_condition(random, extent)
    hot = _floats(20.0 + 0.02 * np.array(condition.distances))
    return dataclasses.replace(condition, board_temperature=(hot, hot)), ()


def _decoy_large_alphas(random: np.random.Generator, extent: Extent) -> tuple[Condition, tuple[str, ...]]:
    """References 40 ppm apart, calibrated."""
    condition = random_condition(random, extent)
    first, second = condition.stations
    first = dataclasses.replace(first, alpha=1.0 + 20e-6, sample_clock_alpha=1.0 + 21e-6)
    second = dataclasses.replace(second, alpha=1.0 - 20e-6, sample_clock_alpha=1.0 - 18e-6)
    return dataclasses.replace(condition, stations=(first, second)), ()


def _decoy_sultry(random: np.random.Generator, extent: Extent) -> tuple[Condition, tuple[str, ...]]:
    """Weather as humid as it gets, measured."""
    n = extent.settings
    weather = {
        'air_temperature': _floats(random.uniform(30, 38, n)),
        'air_humidity': _floats(random.uniform(0.8, 1, n)),
    }
    return random_condition(random, extent, **weather), ()


def _decoy_noisy(random: np.random.Generator, extent: Extent) -> tuple[Condition, tuple[str, ...]]:
    """Strong noise of both kinds, reported as it is."""
    condition = random_condition(random, extent)
    return _stations(condition, noise_floor=-130.0, phase_noise_level=-82.0, phase_noise_corner=200e3), ()


def _decoy_long_cables(random: np.random.Generator, extent: Extent) -> tuple[Condition, tuple[str, ...]]:
    """Delays of 300 ns, calibrated."""
    condition = _stations(random_condition(random, extent), delay=300e-9)
    return dataclasses.replace(condition, short_start_delay=4.0e-6), ()


def _decoy_covariate(random: np.random.Generator, extent: Extent) -> tuple[Condition, tuple[str, ...]]:
    """The true cause's temperature and its innocent companions move together, but not quite."""
    condition = random_condition(random, extent)
    air = np.array(condition.air_temperature)
    boards = [_floats(air + 10.0 + random.normal(0.0, 2.5, len(air))) for _ in range(2)]
    return dataclasses.replace(condition, board_temperature=(boards[0], boards[1])), ('reference_clock_temperature',)


def _decoy_delay_covariate(random: np.random.Generator, extent: Extent) -> tuple[Condition, tuple[str, ...]]:
    """As before, with a delay that follows one board."""
    return _decoy_covariate(random, extent)[0], ('delay_temperature',)


def _decoy_cover(random: np.random.Generator, extent: Extent) -> tuple[Condition, tuple[str, ...]]:
    """A ripple under references far apart, which are calibrated."""
    return _decoy_large_alphas(random, extent)[0], ('sweep_ripple',)


DECOYS: dict[str, Callable[[np.random.Generator, Extent], tuple[Condition, tuple[str, ...]]]] = {
    'boards follow distance': _decoy_hot_null,
    'calibrated alphas far apart': _decoy_large_alphas,
    'sultry weather': _decoy_sultry,
    'reported strong noise': _decoy_noisy,
    'calibrated long delays': _decoy_long_cables,
    'clock follows one of two boards': _decoy_covariate,
    'delay follows one of two boards': _decoy_delay_covariate,
    'ripple beside calibrated alphas': _decoy_cover,
}
"""What leads astray, by name: condition, and the effects that are truly there."""


def _decoy(name: str, random: np.random.Generator, kind: str, d: float, extent: Extent) -> Plan:
    condition, effects = DECOYS[kind](random, extent)
    parts = tuple(part for effect in effects for part in template(random, effect, condition))
    verdicts = ('explained',) if parts else ('consistent',)
    return Plan(name, 'decoy', kind, condition, tuple(Wanted(p, d) for p in parts), verdicts)


# --- ambiguous by construction ---


def _warming(condition: Condition) -> Condition:
    """Return the condition with boards that warm steadily from the calibration temperature on."""
    n = len(condition.distances)
    warm = _floats(25.0 + 12.0 * np.arange(n) / max(n - 1, 1))
    return dataclasses.replace(condition, board_temperature=(warm, warm))


def _ambiguous(name: str, random: np.random.Generator, kind: str, d: float, extent: Extent) -> Plan:
    condition = random_condition(random, extent)
    rivals: tuple[Rival, ...]
    if kind in _TWINS or kind == 'reference_clock_offset':
        (part,) = template(random, kind, condition)
        rivals = _rivals(condition, (part,))
    elif kind == 'clock by time or temperature':
        condition = _warming(condition)
        station = condition.names[int(random.integers(2))]
        part = Applied('reference_clock_temperature', station, {'slope': 0.1})
        other = _other(condition, station)
        rivals = tuple(
            ((effect, where),)
            for effect in ('reference_clock_temperature', 'reference_clock_drift')
            for where in (station, other)
            if (effect, where) != (part.effect, station)
        )
    elif kind == 'delay by either board':
        condition = _warming(condition)
        station = condition.names[int(random.integers(2))]
        part = Applied('delay_temperature', station, {'slope': 1.0})
        rivals = ((('delay_temperature', _other(condition, station)),),)
    else:
        raise ValueError(f"no ambiguous case '{kind}'")
    return Plan(name, 'ambiguous', kind, condition, (Wanted(part, d),), ('ambiguous',), rivals)


AMBIGUOUS = (*sorted(_TWINS), 'reference_clock_offset', 'clock by time or temperature', 'delay by either board')
"""Kinds of cases that one recording cannot decide."""


def decided(case: Case) -> Plan | None:
    """Return a measurement that decides an ambiguous case: the same effects where the boards' temperatures wander.

    None where no recording of these topics decides, such as a delay against an offset of the reference.
    """
    if case.plan.kind not in ('clock by time or temperature', 'delay by either board'):
        return None
    before = case.plan.condition
    random = np.random.Generator(np.random.PCG64(before.seed))
    n = len(before.distances)
    boards = [_floats(random.uniform(10.0, 40.0, n)) for _ in range(2)]
    condition = dataclasses.replace(before, seed=before.seed + 1, board_temperature=(boards[0], boards[1]))
    wanted = tuple(Wanted(effect) for effect in case.effects)
    return Plan(f'{case.plan.name}_decided', 'ambiguous', 'decided', condition, wanted, ('explained',))


# --- lists ---


@dataclasses.dataclass(frozen=True)
class Counts:
    """How many cases of each group."""

    nulls: int  # with the right noise; of each other kind a fifth
    sizes: tuple[float, ...]  # d of single effects
    repeats: int  # of each single effect at each size
    pairs: int
    outside_sizes: tuple[float, ...]
    decoys: int  # of each kind
    ambiguous: int  # of each kind


FULL = Counts(1000, (3.0, 4.0, 5.0, 6.0, 8.0, 10.0, 12.0, 16.0, 25.0), 8, 200, (10.0, 16.0, 25.0), 10, 8)
"""Of the full proof: some 3800 recordings."""

_PAIRS_NEVER = frozenset(frozenset(pair) for pair in _TWINS.items())


def plans(extent: str = 'full', seed: int = 1, counts: Counts = FULL) -> tuple[Plan, ...]:
    """Return the cases of a proof.

    Args:
        extent: 'quick', a dozen of 14 x 8 sweeps, or 'full', of 14 x 24.
        seed: from which everything follows.
        counts: of the full list.

    Raises:
        ValueError: another extent.
    """
    if extent not in ('quick', 'full'):
        raise ValueError(f"no list of cases '{extent}'")
    listed = list(_quick() if extent == 'quick' else _full(counts))
    sequences = np.random.SeedSequence([seed, len(listed)]).spawn(len(listed))
    return tuple(
        build(f'recording_{number:04d}', np.random.Generator(np.random.PCG64(sequence)))
        for number, (build, sequence) in enumerate(zip(listed, sequences, strict=True))
    )


Builder = Callable[[str, np.random.Generator], Plan]


def _quick() -> Iterator[Builder]:
    small = Extent(14, 8)
    for kind in ('right', 'right', 'bump'):
        yield partial(_null, kind=kind, extent=small)
    for effect in ('sweep_ripple', 'echo', 'reference_clock_temperature', 'spur', 'delay_temperature', 'noise_floor'):
        yield partial(_single, effect=effect, d=16.0, extent=small)
    yield partial(_pair, effects=('pll_settling', 'tx_leakage'), d=16.0, extent=small)
    yield partial(_single, effect='phase_jump', d=20.0, extent=small, group='outside')
    yield partial(_ambiguous, kind='delay_offset', d=12.0, extent=small)


def _full(counts: Counts) -> Iterator[Builder]:
    usual = Extent()
    for kind in NULLS:
        for _ in range(counts.nulls if kind == 'right' else counts.nulls // 5):
            yield partial(_null, kind=kind, extent=usual)
    for effect in REGISTERED:
        for d in counts.sizes:
            for _ in range(counts.repeats):
                yield partial(_single, effect=effect, d=d, extent=usual)
    for _ in range(counts.pairs):
        yield partial(_pair, effects=None, d=None, extent=usual)
    for effect in OUTSIDE:
        for d in counts.outside_sizes:
            for _ in range(max(counts.repeats // 2, 1)):
                yield partial(_single, effect=effect, d=d, extent=usual, group='outside')
    for kind in DECOYS:
        for _ in range(counts.decoys):
            yield partial(_decoy, kind=kind, d=14.0, extent=usual)
    for kind in AMBIGUOUS:
        for _ in range(counts.ambiguous):
            yield partial(_ambiguous, kind=kind, d=14.0, extent=usual)


def _pair(
    name: str, random: np.random.Generator, effects: tuple[str, str] | None, d: float | None, extent: Extent
) -> Plan:
    """Return a case of two effects; None draws two that are not degenerate, of d from 12 to 25."""
    condition = random_condition(random, extent)
    while effects is None:
        drawn = random.choice([e for e in REGISTERED if e != 'reference_lag'], 2, replace=False)
        if frozenset(map(str, drawn)) not in _PAIRS_NEVER:
            effects = str(drawn[0]), str(drawn[1])
    parts = tuple(part for effect in effects for part in template(random, effect, condition))
    wanted = tuple(Wanted(part, random.uniform(12.0, 25.0) if d is None else d) for part in parts)
    return Plan(name, 'pair', ' + '.join(sorted(effects)), condition, wanted, ('explained', 'ambiguous'))
