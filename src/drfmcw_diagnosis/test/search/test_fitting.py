"""Fits of explanations: their course must not depend on which process did a part of the work."""

import dataclasses
import pickle

import numpy as np
import pytest
from checkout import DATA
from scenes import record, scene

from drfmcw_diagnosis.compare.comparison import Comparison
from drfmcw_diagnosis.recording.dataset import read_dataset
from drfmcw_diagnosis.search.fits.fitting import Fitting
from drfmcw_diagnosis.search.search import Search
from drfmcw_diagnosis.search.starts.bank import Candidate, of_coefficients
from drfmcw_diagnosis.search.starts.bent import bent_as
from drfmcw_sim.effects import Effect


def start(effect, station, **values):
    return Candidate(effect, station, Effect.registry[effect].recipes[0], values), values


def test_a_start_from_another_process_is_fitted_alike():
    """What comes back from a worker is a copy: a distortion beside it must still count as the same one."""
    comparison = Comparison(read_dataset(DATA / 'recording_0'))
    effects = [('clipping', {'level': -20.0, 'station': 'master'}), ('delay_offset', {'delay': 0.1})]
    comparison.residual = comparison.template([Effect.registry[name](**values) for name, values in effects])
    fitting = Fitting(comparison)
    found = fitting.fit([start('clipping', 'master', level=-20.2), start('delay_offset', '', delay=0.05)])
    linearised = fitting.linearised(found, fitting.slopes(found))
    begun = [*found.start[:1], start('reference_offset', '', offset=-0.01)]
    here = fitting.fit(begun, linearised=linearised)
    there = fitting.fit(pickle.loads(pickle.dumps(begun)), linearised=linearised)
    assert here.linearised is not None and there.linearised is not None
    assert there.misfit == pytest.approx(here.misfit, rel=1e-12)
    assert [e.values for e in there.effects] == [e.values for e in here.effects]


def test_a_refit_to_first_order_ends_where_the_full_model_fits_best():
    """From a few standard deviations off, in data without noise: the model is simulated anew until both agree."""
    comparison = Comparison(read_dataset(DATA / 'recording_0'))
    true = {'clipping': {'level': -28.0}, 'echo': {'excess_range': 9.0, 'relative_power': -30.0, 'phase': 0.5}}
    stations = {'clipping': 'master', 'echo': ''}
    comparison.residual = comparison.template(
        [start(name, stations[name], **values)[0].build(values) for name, values in true.items()]
    )
    search = Search(comparison, without=set(Effect.registry) - {'clipping'})
    off = {'clipping': {'level': -28.02}, 'echo': {'excess_range': 9.002, 'relative_power': -30.1, 'phase': 0.55}}
    begun = search.fit([start(name, stations[name], **values) for name, values in off.items()], 1, rounds=1)
    found = search.again(begun)
    assert begun.linearised is None and found.linearised is not None
    np.testing.assert_allclose(found.template, comparison.template(found.build()), atol=1e-9)
    assert begun.misfit > 5.0 and found.misfit < 0.5
    for effect in found.effects:
        for name in effect.candidate.free:
            assert effect.values[name] == pytest.approx(
                true[effect.candidate.effect][name], abs=0.2 * effect.stds[name]
            )


def test_standard_deviations_are_those_of_slopes_at_the_end():
    """From far off, in data without noise: by what the steps on the way have learnt they would be off."""
    comparison = Comparison(read_dataset(DATA / 'recording_0'))
    true = {'if_filter': {'pole': 9e5}, 'amplitude_loss': {'loss': 3.0}, 'delay_offset': {'delay': 0.1}}
    stations = {'if_filter': 'slave', 'amplitude_loss': '', 'delay_offset': ''}
    comparison.residual = comparison.template(
        [start(name, stations[name], **values)[0].build(values) for name, values in true.items()]
    )
    fitting = Fitting(comparison)
    off = {'if_filter': {'pole': 2e6}, 'amplitude_loss': {'loss': 0.1}, 'delay_offset': {'delay': 0.01}}
    found = fitting.fit([start(name, stations[name], **values) for name, values in off.items()], exact=True)
    slopes = fitting.whitening(fitting.slopes(found))
    expected = np.sqrt(np.diag(np.linalg.inv(slopes @ slopes.T)))
    stated = [e.stds[name] for e in found.effects for name in e.candidate.free]
    assert found.misfit < 0.5
    np.testing.assert_allclose(stated, expected, rtol=0.05)


def speeds_of(comparison):
    values = {f'velocity[{g}]': 0.002 * g for g in range(len(comparison.members))}
    return start('target_motion', '', **values)


def bent_ramp(station):
    """Return the effect of the fewest coefficients."""
    (fewest, *_) = [c for c in of_coefficients((station,)) if c.station == station]
    return fewest


def ramp_of(comparison):
    bent = bent_ramp('slave')
    return bent, {name: 1.0 + 1e-5 * (k % 3) for k, name in enumerate(bent.values)}


@pytest.mark.parametrize('of', [speeds_of, ramp_of])
def test_what_is_held_stays_as_it_is_while_others_are_fitted(of):
    """Also sizes of single groups, and coefficients; a distortion is fitted to the lines that all effects make."""
    comparison = Comparison(read_dataset(DATA / 'recording_0'))
    held, values = of(comparison)
    true = [held.build(values), Effect.registry['clipping'](level=-28.0, station='master')]
    comparison.residual = comparison.template(true)
    others = [(dataclasses.replace(held, held=True), values)]
    found = Fitting(comparison).fit([*others, start('clipping', 'master', level=-28.2)])
    assert found.effects[0].values == values and not found.effects[0].stds
    assert found.effects[1].values['level'] == pytest.approx(-28.0, abs=0.01)


@pytest.mark.parametrize('settled', [True, False])
def test_a_filter_may_have_settled_before_the_first_sample(settled):
    """Whether its answer to the begin of the signal is there, nobody knows: either way nothing is left of it."""
    comparison = Comparison(read_dataset(DATA / 'recording_0'))
    template = comparison.template([Effect.registry['if_filter'](station='slave', pole=1e4)])
    begin = comparison.entries.where(kind='transient', station=1)
    assert np.abs(template[begin]).max() > 10.0  # it would show
    comparison.residual = np.where(begin & settled, 0.0, template)
    fitting = Fitting(comparison)
    found = fitting.fit([start('if_filter', 'slave', pole=1.1e4)])
    for _ in range(4):
        fitting.trust(found)
        found = fitting.fit(found.start)
    assert found.effects[0].values['pole'] == pytest.approx(1e4, rel=0.01)
    left = fitting.whitening(comparison.residual - found.template)[begin]
    assert np.sum(left**2) < np.count_nonzero(template[begin])


def test_a_distortion_is_sought_at_the_level_that_a_filter_leaves():
    """Behind a filter that takes 20 dB of the line, harmonics show a characteristic ten times as curved."""
    comparison = Comparison(read_dataset(DATA / 'recording_0'))
    true = [
        Effect.registry['if_filter'](station='slave', pole=3e4),
        Effect.registry['second_order_distortion'](station='slave', second_order=-8.0),
    ]
    comparison.residual = comparison.template(true)
    tried = {'if_filter', 'second_order_distortion', 'compression', 'spur'}
    search = Search(comparison, without=set(Effect.registry) - tried)
    known = search.fit([start('if_filter', 'slave', pole=3e4)], 0)
    search.trust(known)
    found = search.best_addition(known)[0].effects[-1]
    assert found.key == ('second_order_distortion', 'slave')
    assert found.values['second_order'] == pytest.approx(-8.0, rel=0.1)


def test_a_limit_is_sought_where_another_distortion_carries_samples_beyond_it(tmp_path):
    """Noise alone does not reach the limit from the line, but from crests that an even characteristic lowers."""
    limiter = {'effect': 'clipping', 'station': 'slave', 'level': -34.5}
    curved = {'effect': 'second_order_distortion', 'station': 'slave', 'second_order': -20.0}
    standing = {'standing': {'distances': [140.0, 170.0, 200.0], 'sweeps': 40}}
    comparison = Comparison(read_dataset(record(scene(standing, effects=[limiter, curved]), tmp_path / 'r')))
    distortions = {'second_order_distortion', 'compression', 'clipping', 'spur'}
    search = Search(comparison, without=set(Effect.registry) - distortions)
    known = search.fit([start('second_order_distortion', 'slave', second_order=-20.0)])
    search.trust(known)
    found = search.best_addition(known)[0].effects[-1]
    assert found.key == ('clipping', 'slave')
    assert found.values['level'] == pytest.approx(-34.5, abs=0.1)


def test_what_mirror_lines_bring_by_chance_counts_as_noise():
    """A ramp that bends by 40 kHz spreads mirror lines over the line, at a phase of their own in each sweep.

    What is whitened of 5 draws is 10 % off at most: noise of this variance exceeds that with a chance below 1e-6.
    """
    comparison = Comparison(read_dataset(DATA / 'recording_0'))
    fitting = Fitting(comparison)
    found = fitting.fit([start('sweep_curvature', 'master', deviation=40e3)], 0)
    fitting.trust(found)
    changing = comparison.changing([e.build() for e in found.effects])
    counts = np.array([len(m) for m in comparison.members])[:, None, None]
    std = comparison.std['ramp']
    scatter = np.sqrt(comparison.std['flutter'] * (1.0 + changing) / counts) / std  # of the means, over their std
    kind = next(k for k in comparison.kinds if k.name == 'ramp')
    random, squares, plain = np.random.default_rng(7), [], []
    disturbed = changing.mean(axis=-1) > 1.0
    assert disturbed.any()
    for _ in range(5):
        rest = np.zeros(len(comparison.residual))
        noise = scatter * random.normal(size=scatter.shape)
        for row in range(std.shape[1]):
            rest[comparison.rows(kind, row)] = noise[:, row].ravel()
        whitened = fitting.whitening(rest)
        for row in range(std.shape[1]):
            rows = comparison.rows(kind, row)
            squares.append(whitened[rows].reshape(len(std), -1)[disturbed[:, row]])
            plain.append(rest[rows].reshape(len(std), -1)[disturbed[:, row]])
    mean, without = (float(np.mean(np.concatenate(x) ** 2)) for x in (squares, plain))
    assert without > 1.5
    assert mean < 1.1


def test_mirror_lines_of_a_bent_ramp_leave_its_line():
    """Less than a tenth of the noise of a sweep is left where a ramp bends by 4 kHz."""
    comparison = Comparison(read_dataset(DATA / 'recording_0'))
    bend = Effect.registry['sweep_curvature'](station='master', deviation=4000.0)
    assert comparison.changing((bend,)).mean(axis=-1).max() < 0.1


@pytest.mark.parametrize('station', ['master', 'slave'])
def test_a_bent_ramp_begins_as_the_effect_whose_place_it_takes(station):
    """At its own station, and bent the other way at the other one, as which it beats: far less than 1 % is left."""
    comparison = Comparison(read_dataset(DATA / 'recording_0'))
    fewest = bent_ramp(station)
    curvature = Effect.registry['sweep_curvature'](station='slave', deviation=2e3)
    values = bent_as(fewest, [curvature], comparison.recorded.parts[0].steady)
    wanted, found = comparison.template([curvature]), comparison.template([fewest.build(values)])
    assert np.sum((found - wanted) ** 2) < 1e-2 * np.sum(wanted**2)
