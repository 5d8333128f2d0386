"""Search for effects: what an explanation may follow, effects that nearly cancel, movement."""

import numpy as np
import pytest
from comparing import beginning, compared
from hypothesis import given
from hypothesis import strategies as st

from drfmcw_diagnosis.compare.comparison import Comparison
from drfmcw_diagnosis.compare.steadiness import LIMITS as STEADINESS
from drfmcw_diagnosis.compare.steadiness import gains_over_other_station, odds_of_one_size
from drfmcw_diagnosis.features.limits import SPECTRUM
from drfmcw_diagnosis.judging.rivals import rivals, widened
from drfmcw_diagnosis.judging.verdict import judged
from drfmcw_diagnosis.recording.dataset import read_dataset
from drfmcw_diagnosis.search.fits.fitted import Fitted, FittedEffect, Freedom
from drfmcw_diagnosis.search.fits.fitting import Fitting
from drfmcw_diagnosis.search.leftovers import leftovers
from drfmcw_diagnosis.search.limits import SEARCH
from drfmcw_diagnosis.search.search import Search
from drfmcw_diagnosis.search.selection import Found, searched
from drfmcw_diagnosis.search.starts.bank import Candidate
from drfmcw_proof.cases.concealing import Applied, conceal
from drfmcw_proof.cases.decoys import DECOYS
from drfmcw_proof.cases.draws import Extent, both_stations, random_condition
from drfmcw_proof.generator.model import nominal
from drfmcw_proof.generator.phase_noise import NoiseShape
from drfmcw_proof.generator.recordings import write_recording
from drfmcw_sim.effects import Effect

OF_THE_RANGE = {'delay_offset', 'sample_clock_offset', 'delay_temperature', 'reference_offset'}


def chi_square(comparison, kind, *effects):
    """Squared whitened residual per number of one kind beside effects."""
    rest = comparison.residual - comparison.template(effects)
    chosen = comparison.entries.where(kind=kind) & (comparison.residual != 0.0)
    return float(np.mean(rest[chosen] ** 2))


@given(st.integers(0, 2**32 - 1), st.integers(1, 6))
def test_what_parameters_follow_and_what_is_left_are_orthogonal(seed, parameters):
    random = np.random.default_rng(seed)
    slopes, values = random.standard_normal((parameters, 50)), random.standard_normal((3, 50))
    freedom = Freedom(slopes)
    left = freedom.left(values)
    np.testing.assert_allclose(left @ slopes.T, 0.0, atol=1e-9)
    np.testing.assert_allclose(np.sum(values**2, axis=1), np.sum(left**2, axis=1) + freedom.followed(values))


def test_two_effects_that_nearly_cancel_are_found_together(tmp_path):
    """Alone neither explains half of what both leave; the clock's error is 90 sigma, what both leave 60.

    Searched among what acts on the range alone. The data cannot separate offsets of delay and reference.
    """
    truth = {'delay': 0.2, 'offset': -0.2 * 0.2998, 'deviation': 60.0}
    both = (
        Applied('delay_offset', None, {'delay': truth['delay']}),
        Applied('sample_clock_offset', 'master', {'deviation': truth['deviation']}),
    )
    comparison = compared(tmp_path / 'r', 31, *both, settings=14, sweeps=12)
    found = searched(Search(comparison, without=set(Effect.registry) - OF_THE_RANGE), 0.01).explanation
    names = {e.key for e in found.effects}
    assert ('sample_clock_offset', 'master') in names and len(names) == 2
    assert names & {('delay_offset', ''), ('reference_offset', '')}
    for effect in found.effects:
        for name, value in effect.values.items():
            assert abs(value - truth[name]) < 4.0 * effect.stds[name]


def test_a_crane_that_creeps_moves_within_its_place(tmp_path):
    """Slower than the reference shows within a place; the carrier phase counts it to tens of micrometres."""
    velocity = (0.012, -0.006, 0.009, 0.005, -0.011, 0.004, -0.008)
    comparison = compared(tmp_path / 'r', 32, Applied('target_motion', None, {'velocity': velocity}))
    assert comparison.standing.all()
    assert chi_square(comparison, 'movement') > 1e3
    assert chi_square(comparison, 'movement', Effect.registry['target_motion'](velocity=velocity)) < 2.0


def test_a_drives_sway_shows_in_its_range(tmp_path):
    """From sweep to sweep a drive passes many wavelengths: the range shows what it does beyond the reference."""
    velocity = (1.1, -0.7, 0.9, 0.6, -1.2, 0.8, -0.9)
    motion = Applied('target_motion', None, {'velocity': velocity})
    sway = Applied('sway', None, {'amplitude': 0.08, 'frequency': 0.7, 'phase': 0.0})
    comparison = compared(tmp_path / 'r', 33, motion, sway)
    assert not comparison.standing.any()
    assert chi_square(comparison, 'movement') > 4.0
    effects = (
        Effect.registry['target_motion'](velocity=velocity),
        Effect.registry['sway'](amplitude=0.08, frequency=0.7, phase=0.0),
    )
    # 84 numbers, 5 standard deviations: false failure below 1e-6
    assert chi_square(comparison, 'movement', *effects) < 1.0 + 5.0 * np.sqrt(2.0 / 84)


def test_a_sway_of_many_wavelengths_shows_in_its_range(tmp_path):
    """It passes more than half a turn of the carrier's phase from sweep to sweep, though the reference stands."""
    swung = {'amplitude': 0.6, 'frequency': 0.55, 'phase': 0.3}
    comparison = compared(tmp_path / 'r', 45, Applied('sway', None, swung), settings=8, sweeps=24)
    assert comparison.standing.all() and not comparison.recorded.counted.any()
    assert chi_square(comparison, 'movement') > 100.0
    # 192 numbers, 5 standard deviations: false failure below 1e-6
    assert chi_square(comparison, 'movement', Effect.registry['sway'](**swung)) < 1.0 + 5.0 * np.sqrt(2.0 / 192)
    still = compared(tmp_path / 's', 45, settings=8, sweeps=24)
    assert still.recorded.counted.all()


def test_two_echoes_are_two(tmp_path):
    """Of 50 sigma each, 6 m apart: each excess range to its deviation, by the delay and not by the carrier's phase."""
    truth = {4.2: -48.0, 10.1: -49.0}
    echoes = [
        Applied('echo', None, {'excess_range': excess, 'relative_power': power, 'phase': 1.0})
        for excess, power in truth.items()
    ]
    comparison = compared(tmp_path / 'r', 34, *echoes)
    others = set(Effect.registry) - {'echo', 'ground_reflection', 'sweep_ripple', 'pll_settling'}
    found = searched(Search(comparison, without=others), 0.01).explanation
    assert [e.key for e in found.effects] == [('echo', '')] * 2
    for effect in found.effects:
        value, std = effect.values['excess_range'], effect.stds['excess_range']
        excess = min(truth, key=lambda e: abs(e - value))
        # 4 values, 4.5 standard deviations: false failure below 1e-4
        assert abs(value - excess) < 4.5 * std and std < 0.1
        assert abs(effect.values['relative_power'] - truth[excess]) < 4.5 * effect.stds['relative_power']
    assert len({round(e.values['excess_range']) for e in found.effects}) == 2


def test_a_reflection_follows_the_true_distance_and_not_the_reference(tmp_path):
    """An error of 0.1 m of the reference turns the second ray by 0.4 rad where the target is near."""
    reflection, offset = {'height_product': 50.0, 'coefficient': 0.02}, {'offset': 0.1}
    comparison = compared(
        tmp_path / 'r', 35, Applied('ground_reflection', None, reflection), Applied('reference_offset', None, offset)
    )
    effects = Effect.registry['ground_reflection'](**reflection), Effect.registry['reference_offset'](**offset)
    numbers = np.count_nonzero(comparison.residual[comparison.entries.where(kind='ramp')])
    # 5 standard deviations of some 3000 numbers, and 2 % as those are estimated from scatter: false failure below 1e-6
    assert chi_square(comparison, 'ramp', *effects) < 1.02 + 5.0 * np.sqrt(2.0 / numbers)
    assert chi_square(comparison, 'ramp', effects[0]) > 1.2


def test_two_effects_that_cannot_be_separated_from_others_make_four_explanations(tmp_path):
    """Whose reference is off and whose path is longer: the data determine neither."""
    both = (
        Applied('reference_clock_offset', 'slave', {'deviation': -0.3}),
        Applied('reference_offset', None, {'offset': -0.04}),
    )
    known = {'reference_clock_offset', 'reference_offset', 'delay_offset'}
    search = Search(compared(tmp_path / 'r', 36, *both), without=set(Effect.registry) - known)
    result = searched(search, 0.01)
    explanations = {f.keys for f in [result.explanation, *rivals(search, result.explanation, result.exchanged)]}
    assert explanations == {
        tuple(sorted([('reference_clock_offset', station), (effect, '')]))
        for station in ('master', 'slave')
        for effect in ('reference_offset', 'delay_offset')
    }


def _place(misfit, step, std):
    """An explanation by one settling."""
    recipe, values = Effect.registry['pll_settling'].recipes[0], {'step': step}
    effect = FittedEffect(Candidate('pll_settling', 'master', recipe, values), values, {'step': std})
    return Fitted((effect,), misfit, np.zeros(3), 0.0)


@given(st.floats(0.0, 40.0), st.floats(-20.0, 20.0))
def test_a_second_minimum_that_fits_as_well_widens_the_standard_deviation(behind, apart):
    """Mean squares about the best fit, each place by its likelihood: one that is far behind counts for nothing."""
    best, other = _place(100.0, 5.0, 1.0), _place(100.0 + behind, 5.0 + apart, 1.0)
    value, std = widened(best, [other]).effects[0].widened['step']
    share = np.exp(-behind / 2.0)
    assert value == 5.0
    assert std == pytest.approx(np.sqrt(1.0 + share / (1.0 + share) * apart**2))
    assert widened(best, []) is best


def test_a_hum_is_not_left_at_a_rate_that_fits_best_around(tmp_path):
    """Beside the right rate, 9493 Hz, one 120 Hz higher fits best around; the recording is fixed, no chance decides."""
    hum = Applied('frequency_modulation', 'master', {'deviation': 3100.0, 'rate': 9493.4})
    search = Search(compared(tmp_path / 'r', 62, hum), without=set(Effect.registry) - {'frequency_modulation'})
    aside = search.fit([beginning('frequency_modulation', 'master', {'deviation': 3200.0, 'rate': 9620.0})])
    search.trust(aside)
    aside = search.again(aside)
    assert aside.effects[0].values['rate'] > 9600.0
    found = search.relocated(aside)
    assert found.misfit < aside.misfit - 300.0
    assert found.effects[0].values['rate'] == pytest.approx(9493.4, abs=10.0)


def test_bursts_that_hardly_stand_out_of_the_noise_are_found(tmp_path):
    """Hardly any span holds twice the usual power; the largest power in windows of each sweep shows them."""
    burst = {'probability': 0.2, 'level': -61.0, 'duration': 1.2e-4}
    comparison = compared(tmp_path / 'r', 38, Applied('interference_burst', 'slave', burst), settings=14, sweeps=24)
    loud = [np.any(s.quiet[:, 1] > SPECTRUM.burst * np.median(s.quiet[:, 1]), axis=1) for s in comparison.sweeps]
    assert np.mean(np.concatenate(loud)) < 0.25 * burst['probability']
    known = {'interference_burst', 'noise_floor'}
    found = searched(Search(comparison, without=set(Effect.registry) - known), 0.01).explanation
    assert [e.key for e in found.effects] == [('interference_burst', 'slave')]


def test_bursts_are_found_beside_a_hum(tmp_path):
    """What the hum's random phases leave open is no part of the bursts; the recording is fixed, no chance decides."""
    hum = Applied('frequency_modulation', 'master', {'deviation': 200.0, 'rate': 2019.0})
    burst = Applied('interference_burst', 'master', {'probability': 0.2, 'level': -62.0, 'duration': 7e-5})
    named = 'frequency_modulation', 'interference_burst'
    comparison = compared(tmp_path / 'r', 62, hum, burst, settings=8, sweeps=28)
    search = Search(comparison, without=set(Effect.registry) - set(named))
    found = search.fit([beginning('frequency_modulation', 'master', {'deviation': 150.0, 'rate': 2030.0})])
    search.trust(found)
    (best, *_) = search.best_addition(search.again(found))
    assert best.effects[-1].key == ('interference_burst', 'master')
    assert search.credible(best, found.template)


def test_bursts_stronger_than_the_line_leave_the_noise_between_them_alone(tmp_path):
    """Those at the window's edge show in no span; those that throw a sweep out are missing among the others."""
    burst = {'probability': 0.25, 'level': -10.0, 'duration': 3e-5}
    comparison = compared(tmp_path / 'r', 44, Applied('interference_burst', 'slave', burst), settings=14, sweeps=24)
    z = comparison.residual[comparison.entries.where(kind='noise') & (comparison.residual != 0.0)]
    # 5 standard deviations: false failure below 1e-6
    assert np.mean(z**2) < 1.1 + 5.0 * np.sqrt(2.0 / len(z))
    assert chi_square(comparison, 'movement') < 1.1 + 5.0 * np.sqrt(2.0 / 200)
    search = Search(comparison, without=set(Effect.registry) - {'interference_burst', 'noise_floor', 'phase_noise'})
    found = judged(search, searched(search, 0.01), 0.01).explanation
    assert [e.key for e in found.effects] == [('interference_burst', 'slave')]


def test_where_bursts_spoil_sweeps_everywhere_they_are_not_counted(tmp_path):
    """In the only group of long sweeps some are spoilt: that none is among the others says nothing of how strong.

    The level is found to 6 dB; with that group, it came 11 dB too low. The recording is fixed.
    """
    burst = {'probability': 0.22, 'level': -10.0, 'duration': 1.3e-4}
    distances = 20.0, 60.0, 110.0, 170.0, 240.0, 310.0, 400.0, 470.0, 520.0, 580.0, 700.0
    concealed = Applied('interference_burst', 'slave', burst)
    comparison = compared(tmp_path / 'r', 54, concealed, settings=11, sweeps=17, distances=distances)
    recorded = comparison.recorded
    assert [recorded.whole[part.groups].any() for part in recorded.parts] == [True, False]
    search = Search(comparison, without=set(Effect.registry) - {'interference_burst', 'noise_floor'})
    (effect,) = searched(search, 0.01).explanation.effects
    assert effect.key == ('interference_burst', 'slave')
    assert abs(effect.values['level'] - burst['level']) < 6.0


def test_a_sway_is_known_up_to_its_aliases(tmp_path):
    """Where all groups are 51.9 s apart, a sway of 0.582 Hz and one of 0.563 Hz fit alike: the deviation covers both.

    Alone, the frequency would be known to some uHz. The recording is fixed.
    """
    values = {'amplitude': 0.0052, 'frequency': 0.5822}
    sway = Applied('sway', None, values)
    comparison = compared(tmp_path / 'r', 61, sway, settings=10, sweeps=26, interval=0.006, pause=51.7)
    search = Search(comparison, without=set(Effect.registry) - {'sway'})
    (effect,) = judged(search, searched(search, 0.01), 0.01).explanation.effects
    assert effect.stds['frequency'] < 1e-4
    for name, truth in values.items():
        value, std = effect.widened[name]
        assert abs(value - truth) < 4.0 * std
    assert effect.widened['frequency'][1] > 0.005


@pytest.mark.parametrize('seed', [50, 51, 52])
def test_bursts_leave_the_range_its_uncertainty(tmp_path, seed):
    """The sweeps that hold one are left out of it: its deviation rises by a tenth or two, not eightfold.

    Deviations are pooled over 9 distances of 13 sweeps each; the recordings are fixed.
    """
    burst = Applied('interference_burst', 'slave', {'probability': 0.07, 'level': -10.0, 'duration': 3.6e-5})
    steady, spoilt = (
        compared(tmp_path / f'r{len(effects)}', seed, *effects, settings=9, sweeps=13) for effects in ((), (burst,))
    )
    counts = [np.array([len(rows) for rows in c.members]) for c in (steady, spoilt)]
    ratio = spoilt.std['range'] * np.sqrt(counts[1]) / (steady.std['range'] * np.sqrt(counts[0]))
    assert np.all((0.8 < ratio) & (ratio < 1.4))


def test_a_burst_at_the_edge_of_a_window_turns_no_target(tmp_path):
    """No span of the spectrum shows it; the phase of that sweep alone is off, at a distance where all seem calm."""
    burst = Applied('interference_burst', 'slave', {'probability': 0.25, 'level': -10.0, 'duration': 3e-5})
    weak = Applied('amplitude_loss', None, {'loss': 22.3})
    comparison = compared(tmp_path / 'r', 47, burst, weak, settings=14, sweeps=24)
    count = np.count_nonzero(comparison.residual[comparison.entries.where(kind='movement')])
    assert chi_square(comparison, 'movement') < 1.0 + 5.0 * np.sqrt(2.0 / count)  # false failure below 1e-6


def test_bursts_show_beside_a_distortion_of_the_same_receiver(tmp_path):
    """An even characteristic makes hardly any sweep louder than the others, so it casts no doubt on bursts."""
    concealed = {
        'interference_burst': {'probability': 0.25, 'level': -27.0, 'duration': 1.3e-4},
        'second_order_distortion': {'second_order': -0.3},
    }
    applied = [Applied(name, 'master', values) for name, values in concealed.items()]
    comparison = compared(tmp_path / 'r', 45, *applied, settings=9, sweeps=20)
    distortion = Effect.registry['second_order_distortion'](station='master', second_order=-0.3)
    uneven = comparison.uneven((distortion,)) / comparison.std['burst']
    assert np.abs(np.nan_to_num(uneven)).max() < 0.5
    search = Search(comparison, without=set(Effect.registry) - {*concealed, 'noise_floor'})
    found = judged(search, searched(search, 0.01), 0.01).explanation
    assert {e.key for e in found.effects} == {(name, 'master') for name in concealed}
    (level,) = (e.values['level'] for e in found.effects if e.candidate.kind.bursts)
    assert abs(level + 27.0) < 3.0


def test_a_limit_is_sought_beside_phase_noise_of_its_receiver(tmp_path):
    """What a limit does and what phase noise does are no sum.

    A tenth of a decibel is 20 standard deviations of the level: false failure below 1e-6.
    """
    noise = {'level': -76.0, 'corner': 1.8e5}
    effects = Applied('phase_noise', 'master', noise), Applied('clipping', 'master', {'level': -26.0})
    tried = {'phase_noise', 'clipping', 'compression', 'second_order_distortion', 'spur'}
    search = Search(compared(tmp_path / 'r', 1, *effects), without=set(Effect.registry) - tried)
    known = search.fit([beginning('phase_noise', 'master', noise)])
    search.trust(known)
    found = search.best_addition(known)[0].effects[-1]
    assert found.key == ('clipping', 'master')
    assert found.values['level'] == pytest.approx(-26.0, abs=0.1)


def test_a_limit_that_only_the_crests_of_a_ripple_reach_is_sought_beside_the_echo(tmp_path):
    """An echo of -16 dB raises a line by 1.3 dB in a part of the sweep, and not in the mean: 0.4 dB above the limit.

    The recording is fixed, so nothing is by chance.
    """
    condition = random_condition(np.random.default_rng(63), Extent(7, 12))
    strongest = float(nominal(condition).amplitude(1, np.arange(7 * 12)).max()) / condition.full_scale
    level = 20.0 * float(np.log10(strongest)) + 0.4
    values = {'relative_power': -16.0, 'excess_range': 35.0, 'phase': 0.3}
    effects = Applied('echo', None, values), Applied('clipping', 'slave', {'level': level})
    search = Search(compared(tmp_path / 'r', 63, *effects), without=set(Effect.registry) - {'echo', 'clipping', 'spur'})
    echo = search.again(search.fit([beginning('echo', '', {**values, 'phase': 0.0})]))
    found = search.best_addition(echo)[0].effects[-1]
    assert found.key == ('clipping', 'slave')
    assert found.values['level'] == pytest.approx(level, abs=0.2)


def test_what_clipping_does_to_strong_sweeps_is_no_burst(tmp_path):
    """The limit is reached at the nearest place alone, by the stronger sweeps more than by the others."""
    clipping = Applied('clipping', 'master', {'level': -25.0})
    comparison = compared(tmp_path / 'r', 39, clipping, settings=14, sweeps=24)
    search = Search(comparison, without=set(Effect.registry) - {'clipping', 'interference_burst', 'noise_floor'})
    found = searched(search, 0.01).explanation
    assert [e.key for e in found.effects] == [('clipping', 'master')]
    assert leftovers(search, found)[0].probability > 1e-3  # false failure 0.1 %, the seed is fixed
    (effect,) = found.effects
    assert abs(effect.values['level'] + 25.0) < 0.2


def test_few_sweeps_make_no_mismatch(tmp_path):
    """Six sweeps per distance determine their scatter badly; what is compared by it still looks like noise."""
    squares = {'mean': [], 'harmonic': [], 'coherence': [], 'burst': []}
    for seed in range(40, 48):
        comparison = compared(tmp_path / f'r{seed}', seed, settings=14, sweeps=6)
        assert leftovers(Fitting(comparison), None)[0].probability > 1e-3  # 8 times: false failure 1 %, seeds are fixed
        for kind, found in squares.items():
            z = comparison.residual[comparison.entries.where(kind=kind)]
            found.append(z[z != 0.0])
    for kind, found in squares.items():
        z = np.concatenate(found)
        # variance of squares of Student's distribution with 5 degrees of freedom is four times that of normal ones;
        # 5 standard deviations: false failure below 1e-5
        assert np.mean(z**2) < 1.05 + 5.0 * np.sqrt(4.0 * 2.0 / len(z)), kind


def test_a_line_beyond_nyquist_is_left_out(tmp_path):
    """References 40 ppm apart as calibrated put lines where they fold back: the other sweeps hold nothing amiss."""
    condition, _ = DECOYS['calibrated alphas far apart'](np.random.default_rng(37), Extent(14, 8))
    write_recording(nominal(condition), tmp_path / 'r')
    comparison = Comparison(read_dataset(tmp_path / 'r'))
    assert 6 <= len(comparison.members) < 14
    numbers = np.count_nonzero(comparison.residual[comparison.entries.where(kind='ramp')])
    # as above
    assert chi_square(comparison, 'ramp') < 1.02 + 5.0 * np.sqrt(2.0 / numbers)


def test_a_loss_is_no_reflection_of_no_height(tmp_path):
    """A reflection of small height fits better at first: it follows a part of what else moves the range.

    The data cannot separate offsets of delay and reference.
    """
    effects = (
        Applied('amplitude_loss', None, {'loss': 5.5}),
        Applied('delay_offset', None, {'delay': 0.08}),
        Applied('sample_clock_offset', 'slave', {'deviation': -90.0}),
    )
    comparison = compared(tmp_path / 'r', 36, *effects, settings=8)
    others = set(Effect.registry) - OF_THE_RANGE - {'amplitude_loss', 'ground_reflection', 'air_refractivity'}
    found = searched(Search(comparison, without=others), 0.01).explanation
    names = {e.key for e in found.effects}
    assert len(names) == 3 and {('amplitude_loss', ''), ('sample_clock_offset', 'slave')} <= names
    assert names & {('delay_offset', ''), ('reference_offset', '')}


def test_an_event_without_a_name_hides_no_ripple(tmp_path):
    """A glitch of the frequency at one station, ten times as strong as the other station's ripple.

    Unless it is set aside, ripples imitate it, and nothing stands beside what they leave.
    """
    ripple = {'deviation': 400.0, 'rate': 23_000.0, 'phase': 1.0}
    glitch = {'peak': 900.0, 'time': 4.1e-4, 'width': 4.6e-5}
    effects = Applied('sweep_ripple', 'master', ripple), Applied('frequency_glitch', 'slave', glitch)
    comparison = compared(tmp_path / 'r', 37, *effects)
    others = set(Effect.registry) - {'sweep_ripple', 'pll_settling', 'sweep_curvature', 'echo'}
    search = Search(comparison, without=others)
    judgement = judged(search, searched(search, 0.01), 0.01)
    assert judgement.verdict in ('partial', 'ambiguous') and judgement.remainder
    assert {e.key[0] for e in judgement.explanation.effects} == {'sweep_ripple'}
    (found,) = judgement.explanation.effects
    assert abs(found.values['rate'] - ripple['rate']) < 5.0 * found.stds['rate']


def test_a_sway_much_slower_than_a_group_is_no_drive(tmp_path):
    """Within 60 ms it moves the crane evenly; but the reference, whose slope shows a drive, stands still."""
    sway = Applied('sway', None, {'amplitude': 0.07, 'frequency': 0.79, 'phase': 0.4})
    comparison = compared(tmp_path / 'r', 48, sway, settings=9, interval=6e-3, pause=64.4)
    search = Search(comparison, without=set(Effect.registry) - {'target_motion'})
    judgement = judged(search, searched(search, 0.01), 0.01)
    assert judgement.verdict == 'unexplained'


def test_a_lost_sample_is_no_clock_that_is_off(tmp_path):
    """What follows comes one sample early: its phase is off by the line's frequency, its slope as by a slow clock."""
    lost = Applied('dropped_samples', 'slave', {'count': 1, 'time': 3.1e-4})
    comparison = compared(tmp_path / 'r', 46, lost, settings=10)
    others = set(Effect.registry) - {'sample_clock_offset', 'reference_scale', 'sweep_ripple', 'sweep_rate'}
    search = Search(comparison, without=others)
    judgement = judged(search, searched(search, 0.01), 0.01)
    assert judgement.verdict == 'unexplained'


@pytest.mark.parametrize(
    ('shape', 'effects', 'verdict', 'named'),
    [
        (NoiseShape('flank', 2e4), (), 'unexplained', set()),
        (
            NoiseShape(),
            (Applied('frequency_modulation', 'slave', {'deviation': 120.0, 'rate': 2100.0}),),
            'ambiguous',
            {'frequency_modulation'},
        ),
    ],
)
def test_steep_noise_near_the_line_is_no_modulation(tmp_path, shape, effects, verdict, named):
    """Both raise what changes slowly from sweep to sweep; only a modulation has one size in all sweeps.

    The recordings are fixed, so nothing is by chance. Of which station the modulation is remains open.
    """
    condition = both_stations(random_condition(np.random.default_rng(47), Extent(3, 12)), shape=shape)
    write_recording(conceal(nominal(condition), effects), tmp_path / 'r')
    others = set(Effect.registry) - {'frequency_modulation', 'phase_noise'}
    search = Search(Comparison(read_dataset(tmp_path / 'r')), without=others)
    found = searched(search, 0.01)
    assert (found.explanation is not None) == bool(effects)  # noise is not even taken up
    judgement = judged(search, found, 0.01)
    assert judgement.verdict == verdict
    assert {e.key[0] for e in (judgement.explanation.effects if judgement.explanation else ())} == named


@pytest.mark.parametrize('station', ['master', 'slave'])
def test_of_which_station_a_modulation_is_shows_in_each_sweep(tmp_path, station):
    """Its power is the same in both lines; the other station hears it one path delay later. A fixed recording."""
    hum = {'deviation': 400.0, 'rate': 12e3}
    comparison = compared(tmp_path / 'r', 62, Applied('frequency_modulation', station, hum))
    search = Search(comparison, without=set(Effect.registry) - {'frequency_modulation'})
    both = [search.fit([beginning('frequency_modulation', own, hum)]) for own in comparison.data.stations]
    assert abs(both[0].misfit - both[1].misfit) < SEARCH.rival
    for fitted in both:
        (gain,) = gains_over_other_station(comparison, fitted.build())
        assert gain > SEARCH.rival if fitted.keys[0][1] == station else gain < -SEARCH.rival
        judgement = judged(search, Found(fitted, 0.0, [], both), 0.01)
        assert (judgement.verdict, judgement.explanation.keys) == ('explained', (('frequency_modulation', station),))


def test_a_modulation_has_one_size_even_if_another_one_was_fitted(tmp_path):
    """While other effects are missing, its fitted size may be wrong; it scatters from sweep to sweep all the same."""
    hum = {'deviation': 400.0, 'rate': 12e3}
    comparison = compared(tmp_path / 'r', 62, Applied('frequency_modulation', 'slave', hum))
    for factor in (0.6, 1.0, 1.6):
        fitted = Effect.registry['frequency_modulation'](400.0 * factor, 12e3, station='slave')
        (odds,), (odds_of_any,) = (odds_of_one_size(comparison, [fitted], x) for x in ((1.0,), STEADINESS.any_size))
        assert odds_of_any > 0.0 and (odds > 0.0) == (factor == 1.0)


def test_what_adds_the_same_as_an_effect_is_known(tmp_path):
    """An error of the reference's zero moves all ranges as a delay does; a loss moves none."""
    search = Search(compared(tmp_path / 'r', 62, Applied('delay_offset', None, {'delay': 1.857})))
    effect = search.fit([beginning('reference_offset', '', {'offset': -0.557})]).effects[0]
    alike = search.alike(effect)
    assert {('delay_offset', ''), ('reference_offset', '')} <= alike
    assert ('amplitude_loss', '') not in alike


def test_twins_promise_the_same(tmp_path):
    """A delay and an error of the reference add the same to every range, whatever else is set aside there."""
    search = Search(compared(tmp_path / 'r', 21))
    one, other = (
        next(t for c, t in zip(search.bank, search.templates, strict=True) if c.effect == effect)
        for effect in ('delay_offset', 'reference_offset')
    )
    assert abs(float(one @ other)) > 0.99999 * float(np.linalg.norm(one) * np.linalg.norm(other))
