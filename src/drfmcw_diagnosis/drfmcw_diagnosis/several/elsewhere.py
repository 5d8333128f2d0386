"""How much of a shared effect a recording can hold in which the search did not find it."""

import dataclasses
import math
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from drfmcw_physics.constants import SPEED_OF_LIGHT
from drfmcw_sim.effects import Effect

from ..compare.comparison import Comparison
from ..finding.result import Diagnosis, Estimate, FoundEffect
from ..recording.dataset import read_dataset
from ..recording.thinning import representative, shortened
from ..search.fits.fitted import Freedom
from ..search.fits.fitting import Fitting
from ..search.starts.bank import Candidate, recipes
from .joint import Elsewhere, Shared


@dataclasses.dataclass(frozen=True)
class Question:
    """A recording, its own effects, and the shared effects that were not found in it."""

    path: str
    pair: str | None
    own: tuple[FoundEffect, ...]
    asked: tuple[tuple[str, str | None, dict[str, Estimate]], ...]


def answered(question: Question) -> list[Elsewhere]:
    """Return how much of each effect asked for the recording holds; runs in the worker.

    Each one's size is fitted beside the recording's own effects, whose parameters may follow.
    """
    data = shortened(read_dataset(question.path, question.pair))
    comparison = Comparison(data, representative(data.group))
    fitting = Fitting(comparison)
    freedom: Freedom | None = None
    beside = np.zeros(len(comparison.residual))
    if question.own:
        wave = SPEED_OF_LIGHT / data.sweeps[0][0].center_frequency
        start = [(c, dict(c.values)) for c in (_candidate(f, wave) for f in question.own)]
        fitted = fitting.fit(start, 2)
        fitting.trust(fitted)
        freedom, beside = Freedom(fitting.whitening(fitting.slopes(fitted))), fitted.template
    rest = fitting.whitening(comparison.residual - beside)
    found = []
    for effect, station, parameters in question.asked:
        values = _parameters(effect, parameters)
        own = fitting.whitening(comparison.template([Effect.registry[effect](**values, station=station or '')]))
        left = freedom.left(own) if freedom is not None else own
        power = max(float(left @ left), 1e-12)
        found.append(Elsewhere(question.path, effect, station, float(left @ rest) / power, power**-0.5))
    return found


def _candidate(found: FoundEffect, wave: float) -> Candidate:
    """Return an effect as the search has it; `wave` is the length of the carrier's in mid-sweep [m]."""
    values = {name: e.value for name, e in found.parameters.items()}
    bases = {name.partition('[')[0] for name in values}
    recipe = next(r for name, r in recipes() if name == found.effect and set(r.prior) == bases).at(wave)
    phase, length = recipe.carrier
    if phase:  # what is fitted is its sum with the carrier's
        values[phase] += 2.0 * math.pi * values[length] / wave
    return Candidate(found.effect, found.station or '', recipe, values)


def _parameters(effect: str, parameters: dict[str, Estimate]) -> dict[str, Any]:
    """Return parameters as the registry takes them."""
    single: dict[str, Any] = {}
    for name, estimate in parameters.items():
        base, bracket, _ = name.partition('[')
        if bracket:
            single[base] = (*single.get(base, ()), estimate.value)
        else:
            single[base] = (estimate.value,) if base in Effect.registry[effect].list_parameters() else estimate.value
    return single


def questions(diagnoses: Mapping[str, Diagnosis], shared: Sequence[Shared], pair: str | None) -> list[Question]:
    """Return what to ask which recording: of each effect of hardware that was not found in it."""
    result = []
    for path, diagnosis in diagnoses.items():
        asked = tuple(
            (one.effect, one.station, one.parameters)
            for one in shared
            if one.same_hardware
            and path not in one.recordings
            and (one.station is None or one.station in diagnosis.stations)
        )
        own = diagnosis.explanation.effects if diagnosis.explanation else ()
        if asked:
            result.append(Question(path, pair, own, asked))
    return result
