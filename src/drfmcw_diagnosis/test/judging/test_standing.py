"""Effects beside something unknown: what makes them stand, and how common errors of the models count."""

import dataclasses

import numpy as np
import pytest
import scipy.fft
from checkout import DATA
from hypothesis import given
from hypothesis import strategies as st
from scipy import special

from drfmcw_diagnosis.compare.comparison import Comparison
from drfmcw_diagnosis.compare.groups import Correlated
from drfmcw_diagnosis.engine import diagnose_dataset
from drfmcw_diagnosis.judging.standing import standings, uneven
from drfmcw_diagnosis.recording.dataset import read_dataset
from drfmcw_diagnosis.recording.limits import THINNING
from drfmcw_diagnosis.recording.thinning import representative
from drfmcw_diagnosis.search.events import beyond_events
from drfmcw_diagnosis.search.fits.fitting import Fitting
from drfmcw_diagnosis.search.fits.whitening import Whitening
from drfmcw_diagnosis.search.leftovers import leftovers
from drfmcw_diagnosis.search.search import Search
from drfmcw_diagnosis.search.starts.bank import Candidate
from drfmcw_physics.phase_noise import PhaseNoise, variance_within
from drfmcw_sim.effects import Effect


@pytest.fixture(scope='module')
def data():
    return read_dataset(DATA / 'recording_0')


@given(st.integers(0, 4), st.integers(0, 3), st.integers(0, 2**32 - 1))
def test_common_errors_and_correlated_noise_count_as_their_covariance_says(errors, pairs, seed):
    """The squared length of whitened values is that of the covariance 1 + N^T N, pairs of correlated noise included."""
    generator = np.random.default_rng(seed)
    directions, values = generator.normal(size=(errors, 12)), generator.normal(size=12)
    weight = generator.uniform(0.5, 1.0, 12)
    first, second = generator.permutation(12)[: 2 * pairs].reshape(2, pairs)
    share = generator.uniform(-0.99, 0.99, pairs)
    whitening = Whitening(weight, directions, Correlated(first, second, share))
    common = directions * weight
    covariance = np.eye(12) + common.T @ common
    for at in ((first, second), (second, first)):
        covariance[at] += share * weight[first] * weight[second]
    scaled = values * weight
    assert np.sum(whitening(values) ** 2) == pytest.approx(scaled @ np.linalg.solve(covariance, scaled), rel=1e-9)
    other = generator.normal(size=12)
    assert whitening(values) @ other == pytest.approx(values @ whitening.transposed(other), rel=1e-9, abs=1e-12)


@given(st.lists(st.integers(1, 200), min_size=1, max_size=120))
def test_a_long_recording_is_thinned_evenly(sizes):
    group = np.repeat(np.arange(len(sizes)), sizes)
    rows = representative(group)
    counts = np.bincount(group[rows], minlength=len(sizes))
    assert np.all(np.diff(rows) > 0)
    assert np.count_nonzero(counts) == min(len(sizes), THINNING.groups)
    assert np.all((counts == np.minimum(sizes, THINNING.sweeps)) | (counts == 0))
    assert {0, len(sizes) - 1} <= set(group[rows])


def concealed(comparison, *effects):
    """Return a fit of the effects to what they themselves add to the model: a residual free of noise."""
    comparison.residual = comparison.template(effects)
    return Fitting(comparison)


def fitted(fitting, effect, station, **start):
    several = any('[' in name for name in start)
    recipe = next(r for r in Effect.registry[effect].recipes if r.per_group == several)
    candidate = Candidate(effect, station, recipe, start)
    return fitting.fit([(candidate, start)])


def test_a_true_effect_stands_and_what_imitates_another_does_not(data):
    """A clock that is off stands; a delay that imitates the range at one distance does not. Nothing is by chance."""
    comparison = Comparison(data)
    fitting = concealed(comparison, Effect.registry['sweep_curvature'](deviation=3000.0, station='master'))
    (standing,) = standings(fitting, fitted(fitting, 'sweep_curvature', 'master', deviation=100.0))
    assert standing.stands and standing.over_groups < 1e-3 and standing.predicted > 0.99
    of_range = comparison.entries.where(kind='range')
    bent = np.where(of_range & (comparison.entries.group == 3), 40.0, 0.0)
    comparison.residual = bent
    fitting = Fitting(comparison)
    (standing,) = standings(fitting, fitted(fitting, 'delay_offset', '', delay=0.01))
    assert not standing.stands


@pytest.mark.parametrize(('level', 'seed'), [(-25.0, 2), (-25.1, 0)])
def test_what_one_distance_alone_shows_spoils_no_prediction(data, level, seed):
    """A limit that the lines of one distance alone reach says nothing of a clock that all distances show.

    Both have 20 standard deviations or more, so noise makes them miss a tenth of what they predict at most; three in a
    hundred of the limit's information are from other numbers than the pile, which may miss more. The seeds are fixed.
    """
    comparison = Comparison(data)
    limiter = Effect.registry['clipping'](level=level, station='master')
    fitting = concealed(comparison, limiter, Effect.registry['reference_clock_offset'](deviation=0.05, station='slave'))
    comparison.residual = comparison.residual + np.random.default_rng(seed).normal(size=len(comparison.residual))
    starts = [('clipping', 'master', {'level': level}), ('reference_clock_offset', 'slave', {'deviation': 0.05})]
    found = fitting.fit([(Candidate(e, s, Effect.registry[e].recipes[0], values), values) for e, s, values in starts])
    fitting.trust(found)
    of_limiter, of_clock = standings(fitting, fitting.fit(found.start))
    assert of_clock.stands and of_clock.predicted == pytest.approx(1.0, abs=0.1)
    assert of_limiter.stands and of_limiter.predicted == pytest.approx(1.0, abs=0.3)


@pytest.mark.parametrize(
    ('effect', 'parameters'),
    [
        ('frequency_modulation', {'deviation': 300.0, 'rate': 9000.0}),
        ('interference_burst', {'probability': 0.3, 'level': -45.0, 'duration': 1e-4}),
    ],
)
def test_what_comes_and_goes_stands_beside_an_unknown_gain(data, effect, parameters):
    """No gain modulates the line, nor comes in bursts. Nothing is by chance."""
    comparison = Comparison(data)
    fitting = concealed(comparison, Effect.registry[effect](**parameters, station='master'))
    comparison.residual[comparison.entries.where(kind='amplitude')] += 50.0
    (standing,) = standings(fitting, fitted(fitting, effect, 'master', **parameters))
    # the sweeps themselves, which hold no modulation, do not count here
    assert dataclasses.replace(standing, one_size=np.inf).stands


@pytest.mark.parametrize(('duration', 'stands'), [(1e-4, True), (1.5e-3, False)])
def test_bursts_that_outlast_the_sweep_do_not_stand(data, duration, stands):
    """Whatever makes some sweeps noisier than others looks like them. Nothing is by chance; a sweep takes 1 ms."""
    comparison = Comparison(data)
    bursts = {'probability': 0.2, 'level': -40.0, 'duration': duration}
    fitting = concealed(comparison, Effect.registry['interference_burst'](**bursts, station='master'))
    (standing,) = standings(fitting, fitted(fitting, 'interference_burst', 'master', **bursts))
    assert standing.stands == stands
    assert dataclasses.replace(standing, lasting=0.0).stands


@pytest.mark.parametrize(('bend', 'stands'), [(2e-3, True), (2e-2, False)])
def test_the_range_is_no_evidence_where_the_phase_is_bent_as_far(data, bend, stands):
    """Half a turn of ripple over the sweep may shift the range by 1.1 m per radian rms. Nothing is by chance."""
    comparison = Comparison(data)
    fitting = concealed(comparison, Effect.registry['reference_offset'](offset=0.02))
    kind = next(k for k in comparison.kinds if k.name == 'ramp')
    channel = next(i for i, x in enumerate(comparison.recorded.channels) if x.of_phase)
    std = comparison.std['ramp'][:, channel]
    bent = np.zeros(std.shape[1])
    bent[3] = bend * np.sqrt(len(bent))
    comparison.residual[comparison.rows(kind, channel)] += (bent / std).ravel()
    (standing,) = standings(fitting, fitted(fitting, 'reference_offset', '', offset=0.01))
    assert standing.stands == stands


def test_a_size_is_certain_though_the_shape_is_not(data):
    """A weak settling may be faster and larger, or slower and smaller: it is there, whatever it is."""
    comparison = Comparison(data)
    truth = {'step': 4000.0, 'natural_frequency': 3e4, 'damping': 0.5}
    fitting = concealed(comparison, Effect.registry['pll_settling'](**truth, station='master'))
    found = fitted(fitting, 'pll_settling', 'master', **truth)
    (effect,) = found.effects
    length = float(np.linalg.norm(fitting.whitening(found.template)))
    (standing,) = standings(fitting, found)
    assert effect.values['step'] / effect.stds['step'] < 0.8 * length
    assert standing.certain == pytest.approx(length, rel=0.1)


@pytest.mark.parametrize('onset', [0.0, 4.0])
def test_a_step_of_the_phase_is_no_ripple(data, onset):
    """A ripple follows two thirds of a step within the sweep; beside a true ripple, no event gains as much."""
    comparison = Comparison(data)
    ripple = Effect.registry['sweep_ripple'](deviation=8.0, rate=1700.0, phase=0.4, station='master')
    fitting = concealed(comparison, ripple)
    found = fitted(fitting, 'sweep_ripple', 'master', deviation=5.0, rate=1600.0, phase=0.5)
    length = float(np.linalg.norm(comparison.residual))
    (beyond,) = beyond_events(fitting, found)
    assert beyond > 0.1 * length**2 and standings(fitting, found)[0].stands
    kind = next(k for k in comparison.kinds if k.name == 'ramp')
    last = len(comparison.recorded.channels) - 1  # the difference of both phases
    std = comparison.std['ramp'][:, last]
    blocks = np.arange(std.shape[1])
    step = special.ndtr((blocks - 0.55 * len(blocks)) / max(onset, 1e-3))
    comparison.residual = np.zeros(len(comparison.residual))
    comparison.residual[comparison.rows(kind, last)] = (scipy.fft.dct(step, norm='ortho') / std).ravel()
    comparison.residual *= length / np.linalg.norm(comparison.residual)
    fitting = Fitting(comparison)
    found = fitted(fitting, 'sweep_ripple', 'master', deviation=5.0, rate=1600.0, phase=0.5)
    (beyond,) = beyond_events(fitting, found)
    assert beyond < -0.1 * length**2 and not standings(fitting, found)[0].stands


def test_what_every_distance_has_of_its_own_is_confirmed_by_several_kinds_of_number(data):
    """No distance predicts the velocity at another; Doppler shift, movement and range agree. Nothing is by chance."""
    comparison = Comparison(data)
    velocity = tuple(0.6 * (-1.0) ** group for group in range(len(comparison.members)))
    fitting = concealed(comparison, Effect.registry['target_motion'](velocity=velocity))
    start = {f'velocity[{group}]': 0.5 * v for group, v in enumerate(velocity)}
    (standing,) = standings(fitting, fitted(fitting, 'target_motion', '', **start))
    assert standing.stands and standing.predicted == pytest.approx(1.0, abs=0.05)
    # the phase alone shows a crane that creeps, and any other drift of a delay
    creeping = tuple(5e-4 * v for v in velocity)
    fitting = concealed(comparison, Effect.registry['target_motion'](velocity=creeping))
    start = {f'velocity[{group}]': 0.5 * v for group, v in enumerate(creeping)}
    (standing,) = standings(fitting, fitted(fitting, 'target_motion', '', **start))
    assert standing.gain > 1000.0 and not standing.testable


@pytest.mark.parametrize('creeps', [True, False])
def test_a_drift_that_all_groups_share_is_no_sway(data, creeps):
    """A delay that creeps turns the phase in each group alike, as an alias of a sway does. Nothing is by chance."""
    comparison = Comparison(data)
    if creeps:
        chosen = np.flatnonzero(comparison.entries.where(kind='movement'))
        group, time = comparison.entries.group[chosen], data.time[comparison.entries.position[chosen]]
        way = 0.002 * (time - (np.bincount(group, time) / np.bincount(group))[group])
        comparison.residual = np.zeros(len(comparison.residual))
        comparison.residual[chosen] = way / comparison.std.movement
    else:
        sway = Effect.registry['sway'](amplitude=0.002, frequency=0.6)
        comparison.residual = comparison.template([sway])
    search = Search(comparison, without=set(Effect.registry) - {'sway'})
    (found, *_) = search.best_addition(None)
    (standing,) = standings(search, found)
    assert standing.gain > 100.0
    assert standing.drifting > 0.9 if creeps else standing.drifting < 0.2


def test_phase_noise_takes_power_from_the_line(data):
    """What noisier oscillators change within a block is missing in both lines, as if the path lost it."""
    comparison = Comparison(data)
    noisy = PhaseNoise(-72.0, 2e5)
    known = [PhaseNoise(c.phase_noise_level, c.phase_noise_corner) for c in data.calibration]
    extract = comparison.parts[0].extract
    block = extract.estimator.block, extract.sweeps[0].sample_rate
    added = 2.0 * variance_within(noisy, *block) - sum(variance_within(k, *block) for k in known)
    loss = 10.0 / np.log(10.0) * added
    amplitude = comparison.entries.where(kind='amplitude')
    by_noise, by_path = (
        comparison.template([effect])[amplitude]
        for effect in (
            Effect.registry['phase_noise'](level=noisy.level, corner=noisy.corner),
            Effect.registry['amplitude_loss'](loss=loss),
        )
    )
    assert 0.1 < loss < 1.0
    np.testing.assert_allclose(by_noise, by_path, rtol=0.02)


def test_what_counts_as_noise_is_left_over_nevertheless(data):
    """So that a finding says of what is unknown how much it is, whatever the search beside it takes for noise."""
    comparison = Comparison(data)
    fitting = concealed(comparison, Effect.registry['sweep_curvature'](deviation=3000.0, station='master'))
    before = leftovers(fitting, None)
    assert before[0].probability < 1e-6
    fitting.count_as_noise(None, fitting.set_aside, np.zeros((0, len(comparison.residual))))
    fitting.trust(None)
    assert fitting.misfit(0.0) < 1.01 * len(comparison.residual)
    assert leftovers(fitting, None) == before


def test_what_one_effect_may_explain_does_not_count_as_noise(data):
    """Else an effect that is found last would have made the noise that hides it."""
    comparison = Comparison(data)
    effect = Effect.registry['reference_offset'](offset=0.05)
    fitting = concealed(comparison, effect)
    unexplained = fitting.misfit(0.0)
    fitting.count_as_noise(None, fitting.set_aside, np.zeros((0, len(comparison.residual))))
    fitting.trust(None)
    hidden = fitting.misfit(0.0)
    fitting.count_as_noise(None, fitting.set_aside, 0.1 * comparison.template([effect])[None])
    fitting.trust(None)
    assert fitting.misfit(0.0) > 0.9 * unexplained > 2.0 * hidden


def test_a_reflectors_phase_turns_the_echo(data):
    """Fitted to an echo of any phase, length and phase come out, though many lengths share a carrier phase."""
    comparison = Comparison(data)
    fitting = concealed(comparison, Effect.registry['echo'](excess_range=21.3, relative_power=-25.0, phase=2.0))
    recipe = Effect.registry['echo'].recipes[0]
    total = 2.0 + 2.0 * np.pi * 21.3 / recipe.wavelength
    start = {'relative_power': -28.0, 'excess_range': 21.0, 'phase': total + 0.5}
    candidate = Candidate('echo', '', recipe, start)
    (effect,) = fitting.fit([(candidate, start)]).effects
    assert effect.values['excess_range'] == pytest.approx(21.3, abs=0.01)
    assert effect.values['relative_power'] == pytest.approx(-25.0, abs=0.05)
    assert np.cos(effect.candidate.reflected(effect.values) - 2.0) > 0.9


def test_a_stuck_bit_is_no_noise_and_no_leakage(data):
    """A converter's bit is stuck: neither noise nor leakage is named for it. The recording is fixed."""
    samples = tuple(x.copy() if x is not None else None for x in data.samples)
    samples[0][:] |= 8
    stuck = dataclasses.replace(data, samples=samples)
    comparison = Comparison(stuck)
    assert comparison.codes[0] is not None and comparison.codes[0].probability < 1e-4
    imitators = {'noise_floor', 'tx_leakage', 'phase_noise', 'spur', 'second_order_distortion', 'receiver_settling'}
    found = diagnose_dataset(stuck, without=set(Effect.registry) - imitators)
    assert found.verdict in ('unexplained', 'partial')
    assert found.explanation is None or not {e.effect for e in found.explanation.effects} & {
        'noise_floor',
        'tx_leakage',
    }


@pytest.mark.parametrize(('uneven', 'stands'), [(0.05, True), (1.0, False)])
def test_the_power_is_no_evidence_of_a_loss_where_the_sweep_is_as_uneven(data, uneven, stands):
    """A step of the gain within the sweep changes the mean power as a loss does. The seed is fixed."""
    comparison = Comparison(data)
    fitting = concealed(comparison, Effect.registry['amplitude_loss'](loss=0.3))
    kind = next(k for k in comparison.kinds if k.name == 'ramp')
    std = comparison.std['ramp'][:, 1]  # of the slave's amplitudes
    step = 0.5 * uneven / 8.686 * np.sign(np.arange(std.shape[1]) - 0.5 * std.shape[1])
    rows = comparison.rows(kind, 1)
    noise = np.random.default_rng(7).normal(size=len(rows))
    comparison.residual[rows] = np.where(np.isfinite(std.ravel()), noise, 0.0)
    comparison.residual[rows] += (scipy.fft.dct(step, norm='ortho') / std).ravel()
    fitting = Fitting(comparison)
    (standing,) = standings(fitting, fitted(fitting, 'amplitude_loss', '', loss=0.1))
    assert standing.stands == stands


@pytest.mark.parametrize(('decibels', 'stands'), [(0.5, True), (10.0, False)])
def test_the_noise_is_no_evidence_where_the_amplitude_is_as_wrong(data, decibels, stands):
    """A receiver's gain changes line and noise alike; what changes the line far less is something else."""
    comparison = Comparison(data)
    concealed(comparison, Effect.registry['noise_floor'](excess=10.0, station='slave'))
    kind = next(k for k in comparison.kinds if k.name == 'amplitude')
    step = decibels * np.where(np.arange(len(comparison.members)) < 4, 1.0, -1.0)
    comparison.residual[comparison.rows(kind, 1)] += step / comparison.std['amplitude'][:, 1]
    fitting = Fitting(comparison)
    (standing,) = standings(fitting, fitted(fitting, 'noise_floor', 'slave', excess=5.0))
    assert standing.stands == stands


@pytest.mark.parametrize(('everywhere', 'stands'), [(True, True), (False, False)])
def test_what_one_distance_lacks_does_not_stand(data, everywhere, stands):
    """An echo along a part of the track is none of the whole track, however well it fits where it is."""
    comparison = Comparison(data)
    concealed(comparison, Effect.registry['sweep_ripple'](deviation=3000.0, rate=9000.0, station='master'))
    if not everywhere:
        comparison.residual[comparison.entries.group == 2] = 0.0
    fitting = Fitting(comparison)
    found = fitted(fitting, 'sweep_ripple', 'master', deviation=2500.0, rate=9000.0, phase=0.0)
    (standing,) = standings(fitting, found)
    assert (standing.smallest > 0.9) == standing.stands == stands


@pytest.mark.parametrize(('last', 'stands'), [(1.0, True), (0.0, False)])
def test_at_one_distance_noise_in_one_half_of_the_band_predicts_the_other(data, last, stands):
    """A floor is as high everywhere: noise that falls from 10 dB more to none over the band is no floor."""
    comparison = Comparison(data, np.flatnonzero(data.group == data.group[0]))
    concealed(comparison, Effect.registry['noise_floor'](excess=10.0, station='slave'))
    rows = np.flatnonzero(comparison.entries.where(kind='noise', station=1))
    comparison.residual[rows] *= np.linspace(1.0, last, len(rows))
    fitting = Fitting(comparison)
    (standing,) = standings(fitting, fitted(fitting, 'noise_floor', 'slave', excess=5.0))
    assert standing.stands == stands


@pytest.mark.parametrize(('unknown', 'stands'), [(0.0, True), (30.0, False)])
def test_what_both_lines_share_is_no_evidence_where_the_noise_is_unexplained(data, unknown, stands):
    """A share is relative to the noise: a stuck bit's had made oscillators noisier by their coherence alone."""
    comparison = Comparison(data)
    concealed(comparison, Effect.registry['phase_noise'](level=-84.0, corner=2e5, station='master'))
    rows = np.flatnonzero(comparison.entries.where(kind='noise'))
    comparison.residual[rows] += unknown * (-1.0) ** np.arange(len(rows))
    fitting = Fitting(comparison)
    (standing,) = standings(fitting, fitted(fitting, 'phase_noise', 'master', level=-86.0, corner=2e5))
    assert standing.has_evidence == stands


@pytest.mark.parametrize('in_one_amplitude', [False, True])
def test_an_echo_that_one_amplitude_alone_shows_has_several_sizes(data, in_one_amplitude):
    """A gain that ripples over the sweep looks so: an echo shows as much in both phases as in both amplitudes.

    Noise of every number is added, so that nothing stands out but the ripple; the seed is fixed.
    """
    comparison = Comparison(data)
    recipe = Effect.registry['echo'].recipes[0]
    values = dict(recipe.start) | {'excess_range': 30.0, 'relative_power': -55.0, 'phase': 1.0}
    echo = Candidate('echo', '', recipe, values)
    added = comparison.template([echo.build()])
    if in_one_amplitude:
        added = np.where(comparison.entries.where(kind='ramp', station=1), added, 0.0)
    noise = np.random.default_rng(7).normal(size=len(added)) * (comparison.residual != 0.0)
    comparison.residual = 30.0 * added / np.linalg.norm(added) + noise
    fitting = Fitting(comparison)
    fitted = fitting.fit([(echo, values)], exact=True)
    assert fitted.misfit < fitting.misfit(0.0) - 100.0  # it does imitate
    assert uneven(fitting, fitted) == [in_one_amplitude]
