"""The measured remainder: its file, its way into a scenario, and what it does to the IF."""

import dataclasses

import numpy as np
import pytest
import yaml
from scenes import mapping
from simulated_pairs import SILENT, pair

from drfmcw_physics.settings import ConfigurationError
from drfmcw_sim.effects import Effect
from drfmcw_sim.scenario import read_scenario
from drfmcw_sim.synthesis.measured import Measured, MeasuredModel, Term, read_measured, write_measured
from drfmcw_sim.synthesis.signal_model import synthesise

TIME = np.linspace(1e-5, 1e-3, 80)
BUMP = 0.3 * np.exp(-0.5 * ((TIME - 5e-4) / 1e-4) ** 2)


def term(quantity, values, station='a', grid=None, axis='', at=(0.0,), of=''):
    grid = np.zeros(1) if grid is None else grid
    return Term(quantity, station, axis, of, np.array(at, float), grid, np.atleast_2d(np.array(values, float)))


def measured(*terms, stations=('a', 'b')):
    return Measured(MeasuredModel(stations, 'somewhere', terms))


def analogue(m, *effects):
    return synthesise(m, 1, effects, noise=False, quantised=False)


def test_the_file_holds_the_model_and_the_same_model_gives_the_same_bytes(tmp_path):
    delay = term('delay', [[1e-9], [2e-9]], '', axis='range', at=(10, 20))
    model = measured(term('phase', BUMP, grid=TIME), delay).model
    write_measured(tmp_path / 'one.npz', model)
    write_measured(tmp_path / 'two.npz', model)
    assert (tmp_path / 'one.npz').read_bytes() == (tmp_path / 'two.npz').read_bytes()
    found = read_measured(tmp_path / 'one.npz')
    assert (found.stations, found.recording) == (model.stations, model.recording)
    for one, other in zip(found.terms, model.terms, strict=True):
        for field in dataclasses.fields(Term):
            np.testing.assert_array_equal(getattr(one, field.name), getattr(other, field.name))


@pytest.mark.parametrize(
    'wrong, why',
    [
        (term('phase', BUMP, grid=TIME[::-1]), 'must increase'),
        (term('phase', np.full(80, np.nan), grid=TIME), 'no finite number'),
        (term('phase', BUMP[:40], grid=TIME), 'shape'),
        (term('delay', 1e-9, 'a'), "'delay' is no quantity of station 'a'"),
        (term('gain', 1.0, 'c'), "unknown station 'c'"),
        (term('gain', [[1.0], [2.0]], axis='board_temperature', at=(1, 2), of='c'), "unknown station 'c' of its axis"),
        (term('random_power', -1.0), 'negative power'),
    ],
)
def test_a_model_that_cannot_be_simulated_is_refused_in_one_line(tmp_path, wrong, why):
    write_measured(tmp_path / 'm.npz', measured(wrong).model)
    with pytest.raises(ConfigurationError, match=why) as error:
        read_measured(tmp_path / 'm.npz')
    assert 'm.npz' in str(error.value) and '\n' not in str(error.value)


@pytest.mark.parametrize('content', [b'', b'no archive', None])
def test_what_is_no_model_is_refused_in_one_line(tmp_path, content):
    path = tmp_path / 'm.npz'
    if content is None:
        np.savez(path, format=np.array('something else'))
    else:
        path.write_bytes(content)
    with pytest.raises(ConfigurationError, match='not a measured remainder'):
        read_measured(path)
    with pytest.raises(ConfigurationError, match='no such file'):
        read_measured(tmp_path / 'absent.npz')


def test_another_version_is_refused(tmp_path):
    np.savez(tmp_path / 'm.npz', format=np.array('drfmcw measured remainder'), version=np.array(99))
    with pytest.raises(ConfigurationError, match='version 99'):
        read_measured(tmp_path / 'm.npz')


def test_a_scenario_finds_the_file_beside_it_and_the_registry_lacks_it(tmp_path):
    held = mapping({'standing': {'distances': [100.0], 'sweeps': 2}}) | {'measured': 'm.npz'}
    (tmp_path / 's.yaml').write_text(yaml.safe_dump(held), encoding='utf-8')
    with pytest.raises(ConfigurationError, match=r'measured: .*m\.npz: no such file'):
        read_scenario(tmp_path / 's.yaml')
    write_measured(tmp_path / 'm.npz', measured(term('gain', 1.0, 'master'), stations=('master', 'slave')).model)
    (effect,) = read_scenario(tmp_path / 's.yaml').effects
    assert effect.name == 'measured' and 'measured' not in Effect.registry


def test_gain_and_response_are_factors_of_the_line():
    """6.0206 dB double the signal; the response is its curve at every sample, to the float's rounding."""
    m = pair(n=2, power=-60.0, floor=SILENT)
    plain = analogue(m)
    doubled = analogue(m, measured(term('gain', 20.0 * np.log10(2.0))))
    np.testing.assert_allclose(doubled[0], 2.0 * plain[0], rtol=0, atol=1e-3 * np.abs(plain[0]).max())
    np.testing.assert_array_equal(doubled[1], plain[1])
    risen = analogue(m, measured(term('log_amplitude', BUMP, grid=TIME)))[0]
    t = np.arange(2048) / m.stations[0].sweep.sample_rate
    inside = (t > 2e-5) & (t < 9e-4)
    curve = np.exp(0.3 * np.exp(-0.5 * ((t - 5e-4) / 1e-4) ** 2))
    largest = np.abs(plain[0]).max()
    np.testing.assert_allclose(risen[:, inside], (plain[0] * curve)[:, inside], rtol=0, atol=1e-3 * largest)


def test_a_phase_turns_the_line_of_a_quadrature_receiver():
    m = pair(n=1, power=-60.0, floor=SILENT, iq=True)
    plain, turned = (x[0][..., 0] + 1j * x[0][..., 1] for x in (analogue(m), analogue(m, measured(term('phase', 0.4)))))
    used = np.abs(plain) > 0.5 * np.abs(plain).max()
    np.testing.assert_allclose(np.angle(turned[used] / plain[used]), 0.4, atol=1e-4)


def test_a_curve_over_the_distance_is_interpolated_and_stays_beyond_its_ends():
    m = pair(n=4)
    m.range = np.array([50.0, 110.0, 130.0, 500.0])
    effect = measured(term('delay', [[1e-9], [3e-9], [2e-9]], '', axis='range', at=(100.0, 120.0, 140.0)))
    before = m.paths[0].delay.copy()
    effect.prepare(m)
    np.testing.assert_allclose(m.paths[0].delay - before, [1e-9, 2e-9, 2.5e-9, 2e-9], rtol=1e-6)


def test_random_power_has_its_density_and_the_background_repeats():
    """200 sweeps; the density of 8 bands is within 5 standard deviations (1e-5 by chance), the seed fixed."""
    m = pair(n=200, power=-300.0, floor=SILENT)
    sweep = m.stations[0].sweep
    edges = np.array([0.0, 4e5, 4.1e5, 1.1e6])
    density = np.array([2e-12, 2e-12, 8e-12, 8e-12])
    wave = 1e-3 * np.sin(np.arange(2048) / 30.0)
    added = measured(
        term('random_power', density, grid=edges),
        term('background', wave, grid=np.arange(2048) / sweep.sample_rate),
    )
    samples = analogue(m, added)[0] / m.stations[0].full_scale
    np.testing.assert_allclose(samples.mean(axis=0), wave, atol=6.0 * samples.std() / np.sqrt(200))
    random = samples - wave
    spectrum = np.mean(np.abs(np.fft.rfft(random, axis=1)) ** 2, axis=0) * 2.0 / (sweep.sample_rate * 2048)
    for low, high, expected in ((20, 380, 2e-12), (430, 1000, 8e-12)):
        inside = spectrum[low:high]
        assert abs(inside.mean() / expected - 1.0) < 5.0 / np.sqrt(200 * len(inside))
