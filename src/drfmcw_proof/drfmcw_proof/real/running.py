"""Diagnoses of real recordings: as they are, in halves, several of one radar together, and with something added."""

import dataclasses
import math
import time
from collections.abc import Callable, Sequence
from pathlib import Path

import numpy as np

from drfmcw_diagnosis.engine import LIMITS, diagnose_dataset
from drfmcw_diagnosis.finding.result import Diagnosis
from drfmcw_diagnosis.recording.dataset import Dataset, read_dataset
from drfmcw_diagnosis.scene.judge import examine, own_image, own_ramp, shared_ramps
from drfmcw_diagnosis.scene.ramps.ramp import Ramp
from drfmcw_diagnosis.scene.ramps.shared import carried_over
from drfmcw_physics.settings import ConfigurationError

from .concealing import concealments, first_sweeps, noise_of, swapped, unchanged, wrong_settings

_AGREE = 0.003  # delays of one cable by one shape, relative
_WORSE = 1.5  # misfit by another recording's shape over that with the right setting
_STANDARD_DEVIATIONS = 4.0  # within which a size must come out
_SWEEPS = 96  # of a recording to which effects are added: half a minute for each
_RELATIVE = 0.1  # or within which share of it: what the lines leave biases it
_CELLS = 2.0  # from 0 Hz at which the line stands whose copy must come out, at least
_DECIBEL = 3.0  # within which the level of a copied line must come out: neighbours beat with it
_OF_LINES = frozenset({'sweep_ripple', 'echo'})  # shown by lines, which are not searched for beside
_HIDING = frozenset({'interference_burst', 'sweep_shape'})  # these


@dataclasses.dataclass(frozen=True)
class Found:
    """What a recording holds, as it is."""

    name: str
    sweeps: int
    samples: int
    iq: bool
    diagnosis: Diagnosis | None
    refusal: str  # why there is no diagnosis
    seconds: float

    @property
    def effects(self) -> frozenset[str]:
        """Names of the effects."""
        return named(self.diagnosis)


@dataclasses.dataclass(frozen=True)
class Trial:
    """A recording with something added."""

    recording: str
    effect: str
    words: str
    size: float  # d: root sum of squares of what was added, over the standard deviation of what was left before [1]
    outcome: str  # 'right', 'missed', 'wrong size', 'invented'
    found: str


@dataclasses.dataclass(frozen=True)
class Control:
    """Sweeps of a recording to which nothing was added."""

    recording: str
    words: str
    invented: frozenset[str]  # effects that the whole recording does not show, nor without those that it shows


@dataclasses.dataclass(frozen=True)
class Carried:
    """A shape learnt on one recording, tried on another one of the same radar."""

    learnt: str
    tried: str
    alone: float  # delay by a shape of its own [s]
    together: float  # by the shape of both [s]
    delay: float  # by the other's shape [s]
    known: float  # delay of the recording that it was learnt on [s]
    held_out: float  # misfit of the blocks held out, rms [LSB]
    own: float  # the same by a shape of its own [LSB]


@dataclasses.dataclass(frozen=True)
class Setting:
    """A recording with a wrong setting, beside another one of the same radar whose settings are right."""

    learnt: str
    tried: str
    words: str
    difference: float  # of the delays, relative
    misfit: float  # by the other's shape, over that with the right setting
    held_out: int  # samples

    @property
    def size(self) -> float:
        """Root of the rise of chi-square on what was held out: d."""
        return math.sqrt(self.held_out * max(self.misfit**2 - 1.0, 0.0))

    @property
    def seen(self) -> bool:
        """The delays disagree by more than those of right settings do, or the shape does not fit any more."""
        return abs(self.difference) > _AGREE or self.misfit > _WORSE


def named(diagnosis: Diagnosis | None) -> frozenset[str]:
    """Return the names of the effects of a diagnosis."""
    if diagnosis is None or diagnosis.explanation is None:
        return frozenset()
    return frozenset(e.effect for e in diagnosis.explanation.effects)


def recordings(paths: Sequence[Path]) -> list[Path]:
    """Return the recordings among paths and the directories in them.

    Raises:
        ConfigurationError: a path that is not there, or none that holds a recording.
    """
    found: list[Path] = []
    for path in paths:
        if not path.is_dir():
            raise ConfigurationError(f'--real {path}: no such directory')
        below = sorted(p.parent for p in path.glob('*/metadata.yaml'))
        found += [path] if (path / 'metadata.yaml').exists() else below
    if not found:
        raise ConfigurationError(f'--real {paths[0]}: holds no recording (a directory with metadata.yaml)')
    return found


@dataclasses.dataclass(frozen=True)
class Results:
    """All that was tried."""

    found: list[Found]
    trials: list[Trial]
    controls: list[Control]
    carried: list[Carried]
    settings: list[Setting]
    exchanged: list[tuple[str, bool]]  # whether swapped I and Q were seen


def run(paths: Sequence[Path], seed: int, progress: Callable[[str], None]) -> Results:
    """Return findings, and what became of what was added, left as it is, carried over and set wrong."""
    datasets: dict[str, Dataset] = {}
    results = Results([], [], [], [], [], [])
    for path in paths:
        progress(path.name)
        start = time.monotonic()
        try:
            datasets[path.name] = data = read_dataset(path)
            diagnosis, refusal = diagnose_dataset(data), ''
        except ConfigurationError as error:
            diagnosis, refusal = None, str(error).rpartition(': ')[2]
            if path.name not in datasets:
                results.found.append(Found(path.name, 0, 0, False, None, refusal, time.monotonic() - start))
                continue
        count = data.samples_of(0).shape[1] // (2 if data.iq else 1)
        found = Found(path.name, len(data), count, data.iq, diagnosis, refusal, time.monotonic() - start)
        results.found.append(found)
        short = first_sweeps(data, _SWEEPS)
        plain = examine(short, LIMITS.false_alarm_rate)
        known = found.effects | named(plain)
        results.trials.extend(_trials(path.name, short, known, plain, seed, progress))
        parts = unchanged(short)
        if parts and known:  # a limit hides what sweeps that stay below it show
            known |= named(examine(short, LIMITS.false_alarm_rate, without=known))
        for words, part in parts:
            progress(f'  {words}')
            own = named(examine(part, LIMITS.false_alarm_rate))
            results.controls.append(Control(path.name, words, own - known))
        if data.iq:
            results.exchanged.append((path.name, _sign(data) != _sign(swapped(data))))
    carried, settings = _carried(datasets)
    return dataclasses.replace(results, carried=carried, settings=settings)


def _sign(data: Dataset) -> bool:
    diagnosis = examine(data, LIMITS.false_alarm_rate)
    return bool(diagnosis is not None and diagnosis.scene and diagnosis.scene.get('mirrored'))


def _trials(
    name: str,
    data: Dataset,
    before: frozenset[str],
    plain: Diagnosis | None,
    seed: int,
    progress: Callable[[str], None],
) -> list[Trial]:
    """Return what becomes of what is added to a recording, which shows the effects `before`, diagnosed as `plain`."""
    trials = []
    left = noise_of(data)
    if plain is not None and math.isfinite(plain.fit.held_out.after):
        left *= math.sqrt(max(plain.fit.held_out.after, 1.0))
    for concealed in concealments(data, seed):
        if before & {concealed.effect, 'clipping'} or (concealed.effect in _OF_LINES and before & _HIDING):
            continue  # it is there already, or hides what is added
        progress(f'  {concealed.effect}: {concealed.words}')
        diagnosis = examine(concealed.data, LIMITS.false_alarm_rate)
        size = concealed.size
        own = own_image(data) if concealed.effect == 'iq_imbalance' else None
        if own is not None:  # gains and phases of both add
            size = {'gain': size['gain'] + own.gain, 'phase': size['phase'] + own.phase}
        if concealed.effect == 'echo':
            outcome, text = _lines_of_it(plain, diagnosis, size, before)
        else:
            outcome, text = _outcome(diagnosis, concealed.effect, size, before)
        trials.append(Trial(name, concealed.effect, concealed.words, concealed.added / left, outcome, text))
    return trials


def _lines_of_it(
    plain: Diagnosis | None, diagnosis: Diagnosis | None, size: dict[str, float], before: frozenset[str]
) -> tuple[str, str]:
    """Return whether the copy of the strongest line stands where it must: in a scene an echo is one line more."""
    known, lines_ = _lines(plain), _lines(diagnosis)
    effects = named(diagnosis)
    text = ', '.join(sorted(effects)) or 'nothing'
    if not known or not lines_:
        return 'missed', text
    cell = float(lines_[0]['cell'])
    # what stands next to 0 Hz has no image that could be taken away before it is moved
    strongest = max((x for x in known if abs(x['path']) > _CELLS * cell), key=lambda x: x['level'], default=None)
    if strongest is None:
        return 'missed', text
    path, level = strongest['path'] + size['path'], strongest['level'] + size['level']
    near = [x for x in lines_ if abs(x['path'] - path) < cell]
    if not near:
        return 'missed', text
    line = min(near, key=lambda x: abs(x['path'] - path))
    text += f'; line at {line["path"]:.3g} m, {line["level"] - strongest["level"]:.1f} dB'
    if effects - before:
        return 'invented', text
    return ('right' if abs(line['level'] - level) < _DECIBEL else 'wrong size'), text


def _lines(diagnosis: Diagnosis | None) -> list[dict[str, float]]:
    return (diagnosis.scene or {}).get('lines', []) if diagnosis else []


def _outcome(
    diagnosis: Diagnosis | None, effect: str, size: dict[str, float], before: frozenset[str]
) -> tuple[str, str]:
    effects = diagnosis.explanation.effects if diagnosis and diagnosis.explanation else ()
    text = ', '.join(e.effect for e in effects) or 'nothing'
    of_it = [e for e in effects if e.effect == effect]
    if not of_it:
        return 'missed', text
    if {e.effect for e in effects} - before - {effect}:
        return 'invented', text
    for parameter, value in size.items():
        estimate = of_it[0].parameters[parameter]
        text += f'; {parameter} {estimate.value:.3g} ± {estimate.std:.2g}'
        apart = abs(estimate.value) - value if effect == 'sweep_ripple' else estimate.value - value
        if abs(apart) > max(_STANDARD_DEVIATIONS * estimate.std, _RELATIVE * abs(value)):
            return 'wrong size', text  # of a ripple, the sign goes with the phase
    return 'right', text


def _carried(datasets: dict[str, Dataset]) -> tuple[list[Carried], list[Setting]]:
    """Return every shape, and every wrong setting, tried on every other recording of the same radar."""
    bent = {name: r for name, data in datasets.items() if (r := own_ramp(data)) is not None and r.bends}
    result, settings = [], []
    for learnt, known in bent.items():
        for tried, ramp in bent.items():
            if learnt == tried or not _alike(known, ramp):
                continue
            both = shared_ramps([datasets[learnt], datasets[tried]])
            other = carried_over(known.shape, ramp)
            together = both[1].shape.delay[0] if both[1] is not None else math.nan
            result.append(
                Carried(
                    learnt, tried, float(ramp.shape.delay[0]), float(together), float(other.shape.delay[0]),
                    float(known.shape.delay[0]), other.held_out, ramp.held_out,
                )
            )  # fmt: skip
            for words, data in wrong_settings(datasets[tried]):
                wrong = own_ramp(data)
                if wrong is not None:
                    moved = carried_over(known.shape, wrong)
                    difference = float(moved.shape.delay[0] / known.shape.delay[0]) - 1.0
                    held = int(sum(line.held.sum() for line in moved.lines))
                    settings.append(Setting(learnt, tried, words, difference, moved.held_out / other.held_out, held))
    return result, settings


def _alike(one: Ramp, other: Ramp) -> bool:
    a, b = one.material, other.material
    overlap = min(a.start_frequency + a.bandwidth, b.start_frequency + b.bandwidth) - max(
        a.start_frequency, b.start_frequency
    )
    return bool(np.isclose(a.rate, b.rate) and np.isclose(a.duration, b.duration) and overlap > 0.0)
