"""Effects outside the registry, of the independent generator: what repeats is learnt to a held-out misfit of 1.1."""

import numpy as np
import pytest

from drfmcw_diagnosis.compare.comparison import Comparison
from drfmcw_diagnosis.finding.measured import measured_remainder
from drfmcw_diagnosis.recording.dataset import read_dataset
from drfmcw_diagnosis.search.fits.fitting import Fitting
from drfmcw_diagnosis.search.leftovers import leftovers
from drfmcw_proof.cases.concealing import Applied, conceal
from drfmcw_proof.cases.draws import Extent, random_condition
from drfmcw_proof.generator.model import nominal
from drfmcw_proof.generator.recordings import write_recording

COMPLETE = 1.1


def remainder_of(path, effect, parameters):
    """The measured remainder of a recording that conceals an effect at its second station."""
    condition = random_condition(np.random.default_rng(7), Extent(8, 16))
    write_recording(conceal(nominal(condition), [Applied(effect, condition.names[1], parameters)]), path)
    data = read_dataset(path)
    place = np.concatenate([np.arange(n) for n in np.bincount(data.group)])
    every, fitted, held_out = (Comparison(data, np.flatnonzero(x)) for x in (place < 99, place < 11, place > 10))
    left = [x for x in leftovers(Fitting(every), None) if x.probability < 0.01]
    return measured_remainder(every, None, left, (fitted, None), held_out)[0]


@pytest.mark.parametrize(
    'effect, parameters',
    [
        ('gain_step', {'step': 0.3, 'time': 4e-4}),
        ('phase_jump', {'angle': 0.2, 'time': 5e-4}),
        ('frequency_step', {'step': 3.0, 'temperature': 30.0}),
        ('frequency_glitch', {'peak': 2e4, 'time': 5e-4, 'width': 2e-5}),
    ],
)
def test_what_repeats_is_described_without_a_name(tmp_path, effect, parameters):
    """The recordings are fixed, so nothing is by chance."""
    found = remainder_of(tmp_path / 'r', effect, parameters)
    assert found.held_out.before > 1.1
    assert found.held_out.after <= COMPLETE
    assert found.repeats > 0.95


def test_a_modulation_of_random_phase_is_random(tmp_path):
    """Its frequency is named to a tenth; nothing of it repeats."""
    found = remainder_of(tmp_path / 'r', 'fan_modulation', {'depth': 0.05, 'rate': 9e3, 'duty': 0.5})
    assert not found.curves and found.repeats == 0.0
    assert 9e3 in [pytest.approx(part.modulation, rel=0.1) for part in found.random if part.modulation]
