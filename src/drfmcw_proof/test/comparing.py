"""Recordings that conceal effects, compared with the nominal model, and where the fit of an effect begins."""

import numpy as np

from drfmcw_diagnosis.compare.comparison import Comparison
from drfmcw_diagnosis.recording.dataset import read_dataset
from drfmcw_diagnosis.search.starts.bank import Candidate, recipes
from drfmcw_proof.cases.concealing import conceal
from drfmcw_proof.cases.draws import Extent, random_condition
from drfmcw_proof.generator.model import nominal
from drfmcw_proof.generator.recordings import write_recording


def compared(path, seed, *effects, settings=7, sweeps=12, **changes):
    """A comparison of a recording that conceals effects, its conditions random but for `changes`."""
    condition = random_condition(np.random.default_rng(seed), Extent(settings, sweeps), **changes)
    write_recording(conceal(nominal(condition), effects), path)
    return Comparison(read_dataset(path))


def beginning(effect, station, values):
    """Where the fit of an effect begins."""
    return Candidate(effect, station, dict(recipes())[effect], values), values
