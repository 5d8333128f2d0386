"""The measured remainder: what repeats is learnt and predicts held-out sweeps, what does not is called random."""

import dataclasses

import numpy as np
import pytest
from scenes import record, scene

from drfmcw_diagnosis.compare.comparison import Comparison
from drfmcw_diagnosis.finding import repeating
from drfmcw_diagnosis.finding.measured import measured_remainder, write_model
from drfmcw_diagnosis.finding.refined import write_scenario
from drfmcw_diagnosis.finding.result import Remainder
from drfmcw_diagnosis.learn.smoothing import Covariate, Sample, smooth
from drfmcw_diagnosis.recording.dataset import read_dataset
from drfmcw_diagnosis.search.fits.fitting import Fitting
from drfmcw_diagnosis.search.leftovers import leftovers
from drfmcw_diagnosis.search.starts.bank import Candidate, recipes
from drfmcw_sim.effects import ActsOn, Effect, Of, Stage
from drfmcw_sim.recording import write_recording
from drfmcw_sim.scenario import read_scenario

STANDING = {'standing': {'distances': [120.0, 160.0, 200.0, 240.0, 280.0, 320.0], 'sweeps': 16}}
RIPPLE = {'effect': 'sweep_ripple', 'station': 'slave', 'deviation': 400.0, 'rate': 9000.0, 'phase': 0.5}
COMPLETE = 1.1
"""Held-out misfit that a measured remainder reaches where it repeats."""


@pytest.fixture(scope='module', autouse=True)
def unknown():
    """Effects that no registry has: smooth amplitude, wavy phase, a kink over the distance, a hum, random steps."""
    before = dict(Effect.registry)

    @dataclasses.dataclass(frozen=True)
    class Bump(Effect, name='bump', of=Of.STATION):
        acts_on, stage = ActsOn.AMPLITUDE, Stage.AMPLIFIER

        def receive(self, signal, station, m, streams):
            t = np.arange(station.sweep.sample_count) / station.sweep.sample_rate
            signal *= (1.0 + 0.03 * np.exp(-0.5 * ((t - 4e-4) / 8e-5) ** 2)).astype(np.float32)

    @dataclasses.dataclass(frozen=True)
    class Wavy(Effect, name='wavy', of=Of.STATION):
        acts_on, shapes_chirp = ActsOn.PHASE, True

        def chirp_phase(self, station, u):
            return 0.1 * np.sin(2.0 * np.pi * 3e3 * u + 8e6 * u**2)

    @dataclasses.dataclass(frozen=True)
    class Kink(Effect, name='kink'):
        acts_on, stage = ActsOn.DELAY, Stage.PATHS

        def prepare(self, m):
            beyond = np.maximum(m.range - 220.0, 0.0)
            m.paths[0].delay += 1.5e-12 * beyond
            for station in m.stations:
                station.received_power -= 0.015 * beyond

    @dataclasses.dataclass(frozen=True)
    class Hum(Effect, name='hum', of=Of.STATION):
        acts_on = ActsOn.SAMPLES

        def receive(self, signal, station, m, streams):
            t = np.arange(station.sweep.sample_count) / station.sweep.sample_rate
            signal += (2.0 * np.cos(2.0 * np.pi * 3.1e5 * t) + 6.0 * np.exp(-t / 2e-4)).astype(np.float32)

    @dataclasses.dataclass(frozen=True)
    class Tremor(Effect, name='tremor', of=Of.STATION):
        acts_on, stage = ActsOn.AMPLITUDE, Stage.AMPLIFIER

        def receive(self, signal, station, m, streams):
            t = np.arange(station.sweep.sample_count) / station.sweep.sample_rate
            start = np.array([generator.random() for generator in streams()])[:, None]
            signal *= (1.0 + 0.02 * np.sin(2.0 * np.pi * (15e3 * t + start))).astype(np.float32)

    yield
    Effect.registry.clear()
    Effect.registry.update(before)


def compared(path, *effects, seed=11):
    """Dataset of a recording with effects, and comparisons of all sweeps, of the first two thirds and of the rest."""
    data = read_dataset(record(scene(STANDING, effects=list(effects), reference={'range_std': 0.005}, seed=seed), path))
    place = np.concatenate([np.arange(n) for n in np.bincount(data.group)])
    return (
        data,
        Comparison(data),
        Comparison(data, np.flatnonzero(place < 10)),
        Comparison(data, np.flatnonzero(place > 9)),
    )


def learned(comparisons, chosen=None, again=None):
    every, fitted, held_out = comparisons
    left = [x for x in leftovers(Fitting(every), chosen) if x.probability < 0.01]
    return measured_remainder(every, chosen, left, (fitted, again), held_out)


@pytest.mark.parametrize(
    'effect, quantities',
    [
        ({'effect': 'bump', 'station': 'slave'}, {'log_amplitude'}),
        ({'effect': 'wavy', 'station': 'master'}, {'phase'}),
        ({'effect': 'kink'}, {'delay', 'gain'}),
        ({'effect': 'hum', 'station': 'slave'}, {'background'}),
    ],
    ids=lambda x: x['effect'] if isinstance(x, dict) else '',
)
def test_what_repeats_is_learnt_and_the_refined_model_simulates_it(tmp_path, effect, quantities):
    """Simulated again from the refined configuration, nothing is left beside what was learnt; recordings are fixed."""
    data, *comparisons = compared(tmp_path / 'r', effect)
    found, model = learned(comparisons)
    assert quantities <= {q for curve in found.curves for q in curve.quantities}
    assert found.held_out.after <= COMPLETE and found.held_out.after < found.held_out.before
    assert found.repeats > 0.9 and not found.random
    write_model(tmp_path, model)
    write_scenario(tmp_path / 'refined.yaml', data, (), 'measured.npz')
    write_recording(read_scenario(tmp_path / 'refined.yaml'), tmp_path / 'again')
    again = Comparison(read_dataset(tmp_path / 'again'))
    used = again.residual != 0.0
    assert np.mean((again.residual - again.template((model.effect,)))[used] ** 2) < COMPLETE


def test_beside_a_registered_effect_only_the_rest_is_learnt(tmp_path):
    _, every, fitted, held_out = compared(tmp_path / 'r', RIPPLE, {'effect': 'bump', 'station': 'slave'})
    recipe = next(r for name, r in recipes() if name == 'sweep_ripple')
    start = {name: RIPPLE[name] for name in ('deviation', 'rate', 'phase')}
    begun = [(Candidate('sweep_ripple', 'slave', recipe, start), start)]
    found, _ = learned((every, fitted, held_out), Fitting(every).fit(begun, 3), Fitting(fitted).fit(begun, 3))
    assert [curve.quantities for curve in found.curves] == [('log_amplitude',)]
    assert found.held_out.before < 2.0 and found.held_out.after <= COMPLETE


def test_nothing_is_learnt_where_nothing_was_left_out(tmp_path):
    """The recording is fixed; a new one would have a leftover by chance in less than 1 of 100."""
    _, *comparisons = compared(tmp_path / 'r', seed=5)
    assert learned(comparisons) == (None, None)


def test_what_differs_from_sweep_to_sweep_is_said_with_its_statistics(tmp_path):
    """A modulation whose phase is random: no curve, and its frequency to a tenth."""
    _, *comparisons = compared(tmp_path / 'r', {'effect': 'tremor', 'station': 'slave'})
    found, model = learned(comparisons)
    assert model is None and not found.curves and found.repeats == 0.0
    (slave,) = (part for part in found.random if part.station == 'slave')
    assert slave.modulation == pytest.approx(15e3, rel=0.1)
    said = ' '.join(repeating.sentences(Remainder(0.0, 1.0, (), found)))
    assert 'Random from sweep to sweep at slave' in said and 'modulated at 1' in said


def noisy(rng, curve, covariate, sweeps=6.0, folds=4):
    """Samples of a curve (G, P) with noise of variance one per sweep."""
    noise = rng.standard_normal((folds, *curve.shape)) / np.sqrt(sweeps)
    count = np.full((folds, len(curve)), sweeps)
    axes = [Covariate('', '', np.zeros(len(curve))), Covariate('range', '', covariate)]
    return Sample(curve + noise, count, np.ones(curve.shape)), axes


def test_noise_makes_no_curve():
    """400 samples of noise with 10 distances and 5 numbers: at most 8 curves, less than 1 expected."""
    rng = np.random.default_rng(3)
    x = np.linspace(100.0, 400.0, 10)
    made = [smooth(*noisy(rng, np.zeros((10, 5)), x), ordered=True) for _ in range(400)]
    assert sum(curve is not None for curve in made) <= 8


@pytest.mark.parametrize('shape, most', [('same', 1.01), ('line', 2.6), ('rough', 24.0)])
def test_a_curve_is_as_free_as_the_data_ask(shape, most):
    """It is within 5 of its standard deviations of the truth, mean of squares; the seed is fixed."""
    rng = np.random.default_rng(4)
    x = np.linspace(100.0, 400.0, 24)
    truth = {'same': np.full(24, 3.0), 'line': (x - 250.0) / 20.0, 'rough': 4.0 * rng.standard_normal(24)}[shape]
    curve = smooth(*noisy(rng, truth[:, None], x), ordered=False)
    assert curve is not None and curve.freedom <= most
    apart = (np.interp(x, curve.at, curve.values[:, 0]) - truth) ** 2
    assert apart.mean() < 25.0 * max(curve.variance.mean(), 1.0 / 24.0)
    if shape == 'line':
        assert curve.covariate.axis == 'range' and curve.elsewhere > 0.9
    if shape == 'rough':
        assert curve.freedom > 15.0 and not curve.elsewhere > 0.5
