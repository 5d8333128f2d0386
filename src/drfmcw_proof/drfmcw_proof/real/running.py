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

from .concealing import concealments, swapped, wrong_settings

_AGREE = 0.003  # delays of one cable by one shape, relative
_WORSE = 1.5  # misfit by another recording's shape over that with the right setting
_STANDARD_DEVIATIONS = 4.0  # within which a size must come out


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
    outcome: str  # 'right', 'missed', 'wrong size', 'invented'
    found: str


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


def run(
    paths: Sequence[Path], seed: int, progress: Callable[[str], None]
) -> tuple[list[Found], list[Trial], list[Carried], list[Setting], list[tuple[str, bool]]]:
    """Return findings, trials, shapes carried over, wrong settings, and whether swapped I and Q were seen."""
    datasets: dict[str, Dataset] = {}
    found, trials, exchanged = [], [], []
    for path in paths:
        progress(path.name)
        start = time.monotonic()
        try:
            datasets[path.name] = data = read_dataset(path)
            diagnosis, refusal = diagnose_dataset(data), ''
        except ConfigurationError as error:
            diagnosis, refusal = None, str(error).rpartition(': ')[2]
            if path.name not in datasets:
                found.append(Found(path.name, 0, 0, False, None, refusal, time.monotonic() - start))
                continue
        count = data.samples_of(0).shape[1] // (2 if data.iq else 1)
        found.append(Found(path.name, len(data), count, data.iq, diagnosis, refusal, time.monotonic() - start))
        trials += _trials(path.name, data, found[-1].effects, seed)
        if data.iq:
            exchanged.append((path.name, _sign(data) != _sign(swapped(data))))
    return found, trials, *_carried(datasets), exchanged


def _sign(data: Dataset) -> bool:
    diagnosis = examine(data, LIMITS.false_alarm_rate)
    return bool(diagnosis is not None and diagnosis.scene and diagnosis.scene.get('mirrored'))


def _trials(name: str, data: Dataset, before: frozenset[str], seed: int) -> list[Trial]:
    trials = []
    for concealed in concealments(data, seed):
        if before & {concealed.effect, 'clipping'}:
            continue  # it is there already, or hides what is added
        diagnosis = examine(concealed.data, LIMITS.false_alarm_rate)
        size = concealed.size
        own = own_image(data) if concealed.effect == 'iq_imbalance' else None
        if own is not None:  # gains and phases of both add
            size = {'gain': size['gain'] + own.gain, 'phase': size['phase'] + own.phase}
        outcome, text = _outcome(diagnosis, concealed.effect, size, before)
        trials.append(Trial(name, concealed.effect, concealed.words, outcome, text))
    return trials


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
        if abs(estimate.value - value) > _STANDARD_DEVIATIONS * estimate.std:
            return 'wrong size', text
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
                    settings.append(Setting(learnt, tried, words, difference, moved.held_out / other.held_out))
    return result, settings


def _alike(one: Ramp, other: Ramp) -> bool:
    a, b = one.material, other.material
    overlap = min(a.start_frequency + a.bandwidth, b.start_frequency + b.bandwidth) - max(
        a.start_frequency, b.start_frequency
    )
    return bool(np.isclose(a.rate, b.rate) and np.isclose(a.duration, b.duration) and overlap > 0.0)
