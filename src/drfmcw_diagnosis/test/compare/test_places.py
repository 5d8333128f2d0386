"""Where the crane stands: its phase from sweep to sweep, and reflections beside what moves it."""

import numpy as np
import pytest
from checkout import DATA

from drfmcw_diagnosis.compare.comparison import Comparison
from drfmcw_diagnosis.compare.kinds.path import unwrapped
from drfmcw_diagnosis.recording.dataset import read_dataset
from drfmcw_diagnosis.search.search import Search
from drfmcw_diagnosis.search.starts.bank import Candidate
from drfmcw_fusion.tracking import doppler_range_rate
from drfmcw_physics.constants import SPEED_OF_LIGHT
from drfmcw_sim.effects import Effect

OTHERS = set(Effect.registry) - {
    'amplitude_loss',
    'delay_offset',
    'echo',
    'ground_reflection',
    'reference_lag',
    'reference_offset',
    'slant_geometry',
    'sway',
    'sweep_ripple',
    'target_motion',
}
"""What a reflection is not confounded with, and a search need not try."""


@pytest.mark.parametrize('rate', [-2.8, -0.3, 0.0, 1.7, 2.8])
def test_a_phase_is_counted_over_missing_sweeps(rate):
    """Between neighbours it turns by less than half a turn, in the gaps by more."""
    number = np.array([0, 1, 2, 4, 5, 6, 9, 10, 11, 12])
    time = 3.0 + 0.02 * number
    phase = 0.4 + rate * number + 0.1 * np.sin(number)
    found = unwrapped(np.angle(np.exp(1j * phase)), time)
    assert found - found[0] == pytest.approx(phase - phase[0], abs=1e-9)


def test_a_phase_is_counted_over_a_missing_sweep_of_a_sway():
    """It turns by 0.19 turns a sweep before the gap and behind it, the other way than on the whole."""
    number = np.delete(np.arange(22), 20)
    time = 0.0324 * number
    phase = 2.0 * np.pi * 4.8 * np.sin(2.0 * np.pi * 0.373 * (time + 0.25))
    found = unwrapped(np.angle(np.exp(1j * phase)), time)
    assert found - found[0] == pytest.approx(phase - phase[0], abs=1e-9)


@pytest.mark.parametrize('turns', [0.1, 0.3, 0.6, 1.0])
def test_few_sweeps_stand_for_a_sway(turns):
    """The mean of few places and velocities is that of all sweeps of a group within 0.1 mm of 130."""
    comparison = Comparison(read_dataset(DATA / 'recording_0'))
    time = [comparison.data.time[m] for m in comparison.members]
    amplitude, rate, phase = 0.13, 2.0 * np.pi * turns / max(map(np.ptp, time)), 0.7
    sway = Effect.registry['sway'](amplitude=amplitude, frequency=rate / (2.0 * np.pi), phase=phase)
    shown = comparison.template([sway])[comparison.entries.where(kind='range')] * comparison.std.range
    sweep = comparison.parts[0].extract.sweeps[0]
    doppler = doppler_range_rate(sweep.center_frequency, sweep.chirp_rate, 0.5 * sweep.ramp_duration)
    way = [np.mean(np.sin(rate * t + phase) + doppler * rate * np.cos(rate * t + phase)) for t in time]
    assert shown == pytest.approx(amplitude * np.array(way), abs=1e-4)


def test_a_reflection_is_sought_where_a_sway_has_the_crane():
    """Its fringes follow the true distance to a part of the wavelength, here 0.3 m from what the reference says."""
    comparison = Comparison(read_dataset(DATA / 'recording_0'))
    sway = {'amplitude': 0.3, 'frequency': 0.11, 'phase': 0.4}
    ground = {'coefficient': -0.05, 'height_product': 93.6}
    both = [Effect.registry['sway'](**sway), Effect.registry['ground_reflection'](**ground)]
    comparison.residual = comparison.template(both)
    search = Search(comparison, without=OTHERS)
    recipe = Effect.registry['sway'].recipes[0]
    known = search.fit([(Candidate('sway', '', recipe, sway), sway)], 0)
    found = search.best_addition(known)[0].effects[-1]
    assert found.key == ('ground_reflection', '')
    assert found.values['height_product'] == pytest.approx(ground['height_product'], abs=0.05)
    assert found.values['coefficient'] == pytest.approx(ground['coefficient'], rel=0.05)


def test_an_error_of_the_reference_adds_the_same_as_a_delay_beside_a_bent_ramp():
    """Either changes the line's frequency, by which the ramp bends each block; a part of a turn changes nothing.

    A settling of 220 kHz adds ten million squared standard deviations. The two are alike within one.
    """
    comparison = Comparison(read_dataset(DATA / 'recording_0'))
    settling = Effect.registry['pll_settling'](station='master', step=-2.2e5, natural_frequency=1.5e4, damping=0.61)
    delay = 0.1532  # [ns]
    longer = Effect.registry['delay_offset'](delay=delay)
    nearer = Effect.registry['reference_offset'](offset=-delay * 1e-9 * SPEED_OF_LIGHT)
    one, other = (comparison.template([settling, effect]) for effect in (longer, nearer))
    assert float(np.sum((one - other) ** 2)) < 1.0
    assert float(np.sum(one**2)) > 1e6


@pytest.fixture(scope='module')
def driving():
    """A crane that drives at every distance."""
    return read_dataset(DATA / 'recording_5')


def driven(comparison):
    """Return the velocities that the reference shows at each distance, rounded."""
    return tuple(np.round(comparison.slope, 2).tolist())


def candidate(search, effect, **values):
    """Return where a fit of an effect begins, with the first of its starting points in the bank and values."""
    several = any('[' in name for name in values)
    begun = next(c for c in search.bank if c.effect == effect and c.recipe.per_group == several)
    return begun, begun.values | values


def by_group(velocities):
    return {f'velocity[{g}]': v for g, v in enumerate(velocities)}


def test_a_late_reference_lags_by_the_velocity_that_is_fitted(driving):
    """The slope of its own readings is noisy: 15 mm/s would be 3 mm for 0.2 s."""
    comparison = Comparison(driving)
    velocity = np.array(driven(comparison)) + 0.02
    motion = Effect.registry['target_motion'](velocity=tuple(velocity.tolist()))
    late = Effect.registry['reference_lag'](lag=0.2)
    chosen = comparison.entries.where(kind='range')
    added = comparison.template([motion, late]) - comparison.template([motion])
    assert added[chosen] * comparison.std.range == pytest.approx(0.2 * velocity, rel=1e-3)


def test_velocities_are_found_beside_what_shifts_the_range(driving):
    """What has no name may shift each line far more than the Doppler effect does: it is taken out first."""
    comparison = Comparison(driving)
    velocity = driven(comparison)
    shifted = np.zeros((1, len(comparison.residual)))
    shifted[0, comparison.entries.where(kind='range')] = 3.0 * comparison.recorded.distance / comparison.std.range
    comparison.residual = 0.1 * shifted[0] + comparison.template([Effect.registry['target_motion'](velocity=velocity)])
    search = Search(comparison)
    search.set_aside = shifted
    search.trust(None)
    found = search.best_addition(None)[0].effects[-1]
    assert found.key == ('target_motion', '')
    assert [found.values[name] for name in by_group(velocity)] == pytest.approx(velocity, abs=0.01)


def test_a_reflection_is_sought_where_a_late_reference_has_the_crane(driving):
    """At 1.6 m/s it is 0.5 m farther on, and its fringes turn while it drives."""
    comparison = Comparison(driving)
    velocity = driven(comparison)
    ground = {'coefficient': 0.06, 'height_product': 161.7}
    effects = {'target_motion': {'velocity': velocity}, 'reference_lag': {'lag': 0.3}, 'ground_reflection': ground}
    comparison.residual = comparison.template([Effect.registry[name](**values) for name, values in effects.items()])
    search = Search(comparison, without=OTHERS)
    start = [candidate(search, 'target_motion', **by_group(velocity)), candidate(search, 'reference_lag', lag=0.3)]
    found = search.best_addition(search.fit(start, 0))[0].effects[-1]
    assert found.key == ('ground_reflection', '')
    assert found.values['height_product'] == pytest.approx(ground['height_product'], abs=0.05)


def test_a_reflection_says_whether_the_path_or_the_reference_is_off():
    """A delay of 1.6 ns resembles an offset of 0.48 m, but only the offset moves the crane."""
    comparison = Comparison(read_dataset(DATA / 'recording_0'))
    ground = {'coefficient': -0.06, 'height_product': 93.6}
    true = [Effect.registry['delay_offset'](delay=-1.6), Effect.registry['ground_reflection'](**ground)]
    comparison.residual = comparison.template(true)
    search = Search(comparison, without=OTHERS)
    known = search.fit([candidate(search, 'reference_offset', offset=0.48)])
    with_reflection = next(f for f in search.best_addition(known) if f.effects[-1].key[0] == 'ground_reflection')
    found = search.relocated(with_reflection)
    assert [e.key[0] for e in found.effects] == ['delay_offset', 'ground_reflection']
    assert found.effects[1].values['height_product'] == pytest.approx(ground['height_product'], abs=0.05)
    assert found.effects[0].values['delay'] == pytest.approx(-1.6, rel=0.01)
