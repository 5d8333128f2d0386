"""Scenes of a station that hears itself: ramps bent by per cents, limits, bursts and images are found, nothing else."""

import dataclasses
import json
import math

import numpy as np
import pytest
from scenes import STANDARD_STATION, record
from scipy.interpolate import BSpline

from drfmcw_diagnosis.diagnose import main
from drfmcw_diagnosis.engine import diagnose
from drfmcw_diagnosis.recording.dataset import read_dataset
from drfmcw_diagnosis.scene.background import background
from drfmcw_diagnosis.scene.bursts import bursts
from drfmcw_diagnosis.scene.evidence import of_background, of_side
from drfmcw_diagnosis.scene.images import image
from drfmcw_diagnosis.scene.judge import examine
from drfmcw_diagnosis.scene.lines import Receiver, demanded, joint_lines, limited_fit
from drfmcw_diagnosis.scene.material import Material, material
from drfmcw_diagnosis.scene.rails import limit
from drfmcw_diagnosis.scene.ramps.ramp import ramp
from drfmcw_diagnosis.scene.ramps.shared import carried_over, together
from drfmcw_diagnosis.scene.refining import measured, write_refined
from drfmcw_diagnosis.scene.track import track
from drfmcw_sim.effects import Effect
from drfmcw_sim.scenario import read_scenario, scenario_from_mapping
from drfmcw_sim.synthesis.measured import write_measured

FREE_RUNNING = [1.1, 0.92, 1.05, 0.97, 1.08, 0.9, 1.04, 0.95, 1.02, 0.93]
"""Coefficients of a bent ramp's rate; 6 % rms."""


def looped_back(path, distances=(40.0,), sweeps=1, iq=False, effects=(), seed=5):
    """A recording of a station with a cable, without the noise of its oscillator."""
    station = STANDARD_STATION | {'delay': 12e-9, 'phase_noise_level': math.nan}
    scenario = {
        'stations': {'radar': station},
        'pairs': [{'first': 'radar', 'second': 'radar', 'standing': {'distances': list(distances), 'sweeps': sweeps}}],
        'waveform': {'iq': iq},
        'reference': {'enabled': False},
        'effects': [{'station': 'radar'} | effect for effect in effects],
        'seed': seed,
    }
    return record(scenario_from_mapping(scenario, 'test'), path)


def scene(signal, full_scale=2048.0):
    """Sweeps (n, N) of a radar at 60 GHz."""
    return Material('radar', signal, 2e6, 60e9, 1e9, signal.shape[1] / 2e6, full_scale, np.zeros(len(signal), int))


def several_lines(rng, sweeps=40, count=256, iq=True, noise=2.0):
    """Lines that stand still and lines that move, in noise."""
    t, n = np.arange(count), np.arange(sweeps)[:, None]
    phases = [(0.05, 0.0, 300.0), (0.11, 0.07, 250.0), (0.17, -0.21, 120.0), (0.23, 0.33, 90.0)]
    x = sum(a * np.exp(2j * np.pi * (f * t + d * n + rng.random())) for f, d, a in phases)
    x = x + noise * (rng.normal(size=x.shape) + 1j * rng.normal(size=x.shape))
    return x if iq else np.rint(x.real)


@pytest.mark.parametrize('sweeps', [1, 6])
def test_a_bent_ramp_between_dead_time_and_fly_back_is_named(tmp_path, sweeps):
    """The window to a few samples, the rate's curve to 1 %, the delay to what window and scale allow."""
    bent = {'effect': 'sweep_shape', 'relative_rate': FREE_RUNNING}
    narrow = {'effect': 'ramp_window', 'start': 3e-5, 'end': 9.4e-4}
    found = diagnose(looped_back(tmp_path / 'r', sweeps=sweeps, effects=(bent, narrow)), out=tmp_path)
    named = {e.effect: e.parameters for e in found.explanation.effects}
    assert {'ramp_window', 'sweep_shape'} <= set(named)
    assert abs(named['ramp_window']['start'].value - 3e-5) < 6e-6
    assert abs(named['ramp_window']['end'].value - 9.4e-4) < 6e-6
    assert found.fit.held_out.after < 0.05 * found.fit.held_out.before
    assert any('cannot be separated from the length' in sentence for sentence in found.not_testable)
    learnt = Effect.registry['sweep_shape']([named['sweep_shape'][f'relative_rate[{i}]'].value for i in range(8)])
    assert len(learnt.relative_rate) == 8


def test_the_curve_of_the_rate_is_the_one_concealed(tmp_path):
    bent = {'effect': 'sweep_shape', 'relative_rate': FREE_RUNNING}
    found = ramp(material(read_dataset(looped_back(tmp_path / 'r', effects=(bent,)))))
    x = np.linspace(0.0, 1.0, len(found.lines[0].frequency))
    knots = np.concatenate([np.zeros(3), np.linspace(0.0, 1.0, len(FREE_RUNNING) - 2), np.ones(3)])
    truth = BSpline(knots, np.array(FREE_RUNNING), 3)(x)
    inside = slice(100, -100)
    assert np.std((found.rate() - truth / truth.mean())[inside]) < 0.01
    assert found.bends and found.narrower == (False, False)


def test_one_shape_carries_over_to_another_cable(tmp_path):
    """Learnt together or on the short one alone, the ratio of both delays is that of the lengths to 0.3 %."""
    bent = {'effect': 'sweep_shape', 'relative_rate': FREE_RUNNING}
    ramps = [
        ramp(material(read_dataset(looped_back(tmp_path / str(d), (d,), effects=(bent,), seed=int(d)))))
        for d in (30.0, 90.0)
    ]
    truth = np.array([30.0, 90.0]) * 1.0003 / 299792458.0 + 12e-9
    short, long = (float(r.shape.delay[0]) for r in together(ramps))
    assert abs(long / short / (truth[1] / truth[0]) - 1.0) < 0.003
    carried = carried_over(ramps[0].shape, ramps[1])
    assert abs(carried.shape.delay[0] / ramps[0].shape.delay[0] / (truth[1] / truth[0]) - 1.0) < 0.003
    assert carried.held_out < 0.2 * carried.amplitude


def test_recordings_of_one_oscillator_share_its_shape_and_another_radar_does_not(tmp_path, capsys):
    """Ratio of the delays to 0.3 %; a shape learnt on one predicts the other; the third ramp has a shape of its own."""
    other = list(reversed(FREE_RUNNING))
    paths = [
        str(looped_back(tmp_path / name, (d,), effects=[{'effect': 'sweep_shape', 'relative_rate': rate}], seed=seed))
        for name, d, rate, seed in (('a', 30.0, FREE_RUNNING, 1), ('b', 50.0, FREE_RUNNING, 2), ('c', 40.0, other, 3))
    ]
    others = ','.join(sorted(set(Effect.registry) - {'sweep_shape', 'ramp_window', 'amplitude_slope'}))
    assert main([*paths, '--without', others, '--out', str(tmp_path / 'out'), '--jobs', '1']) == 0
    said = ' '.join(capsys.readouterr().out.split())
    assert 'Shared: shape of the ramp at radar (a, b)' in said and 'Only in c: shape of the ramp at radar' in said
    ramps = json.loads((tmp_path / 'out/joint.json').read_text(encoding='utf-8'))['ramps']
    a, b, c = ({r['recording']: r for r in ramps}[p] for p in paths)
    assert (a['shares_with'], b['shares_with'], c['shares_with']) == (paths[1:2], paths[:1], [])
    delays = [d * 1.0003 / 299792458.0 + 12e-9 for d in (30.0, 50.0)]
    assert abs(b['delay'] / a['delay'] / (delays[1] / delays[0]) - 1.0) < 0.003
    for one in (a, b):
        assert one['predicted'] < 0.25 * one['straight'] and abs(one['predicted_delay'] / one['delay'] - 1.0) < 0.003
    page = (tmp_path / 'out/joint.html').read_text(encoding='utf-8')
    assert 'Shape of the ramp' in page


def test_a_straight_ramp_is_left_to_the_comparison_of_features(tmp_path):
    data = read_dataset(looped_back(tmp_path / 'r', sweeps=4))
    assert examine(data, 0.01) is None
    assert not ramp(material(data)).bends


@pytest.mark.parametrize('iq', [False, True])
def test_a_scene_of_lines_in_noise_shows_nothing(iq):
    """Twenty scenes; a chance of 1e-6 each at most."""
    for seed in range(20):
        m = scene(several_lines(np.random.default_rng(seed), iq=iq))
        assert limit(m) is None
        assert bursts(m) is None
        assert image(m) is None


@pytest.mark.parametrize('shape', [(1, 16), (2, 40), (9, 64), (200, 33), (3, 600)])
@pytest.mark.parametrize('iq', [False, True])
def test_samples_of_any_kind_are_looked_at(shape, iq):
    """Nothing, a constant, noise below a code, waves in step with the samples: no error, and no limit in a wave.

    Waves have noise of one code.
    """
    rng, t = np.random.default_rng(5), np.arange(shape[1])
    noise = rng.normal(0.0, 1.0, shape)
    slow = 900.0 + 300.0 * np.cos(2 * np.pi * 0.02 * t) + noise
    waves = 300.0 * np.cos(2 * np.pi * 0.083 * t) + 200.0 * np.cos(2 * np.pi * 0.12 * t) + noise
    kinds = (0.0 * t, 0.0 * t + 100.0, 0.3 * noise, slow, waves)
    for kind in kinds:
        x = np.rint(np.broadcast_to(kind, shape) + 0.0)
        m = scene(x + 1j * np.roll(x, 3, axis=1) if iq else x)
        assert limit(m) is None
        assert bursts(m) is None
        image(m), ramp(m), of_side(m)
        repeated = background(m)
        assert repeated is None or of_background(repeated, track(m), m)


def test_samples_at_the_rails_are_clipped():
    x = several_lines(np.random.default_rng(1), iq=False)
    found = limit(scene(np.clip(x, -420.0, 420.0) + 0.0))
    assert abs(found.level - 420.0) < 3.0 * max(found.level_std, 1.0)
    assert abs(found.share - np.mean(np.abs(x) >= 420.0)) < 0.01


def drooping():
    """Sweeps of two lines at 50 Hz and 130 Hz in 1 s, noise in front of a limiter, a high-pass of 8 Hz behind it."""
    rng, rate = np.random.default_rng(2), 20_000.0
    t = np.arange(20_000) / rate
    x = np.array([3e4 * np.sin(2 * np.pi * (50.0 * t + p)) + 1e4 * np.sin(2 * np.pi * 130.0 * t) for p in range(4)])
    x = np.clip(x + rng.normal(0.0, 20.0, x.shape), -1.2e4, 1.2e4)
    held, out = np.zeros(len(x)), np.empty_like(x)
    for i in range(x.shape[1]):
        out[:, i] = x[:, i] - held
        held += out[:, i] * 2.0 * np.pi * 8.0 / rate
    signal = np.rint(out + rng.normal(0.0, 1.0, x.shape))
    return Material('radar', signal, rate, 2e8, 2e8, 1.0, 32768.0, np.zeros(4, int))


def test_plateaus_that_droop_are_clipped_in_front_of_a_high_pass():
    found = limit(drooping())
    assert found is not None and found.pole is not None
    assert abs(found.pole[0] - 8.0) < 1.0
    assert abs(found.level / 1.2e4 - 1.0) < 0.1


@pytest.mark.parametrize('iq', [False, True])
def test_lines_refined_together_leave_noise(iq):
    """Four lines 30 to 41 dB above the noise; chance of a false failure below 1e-6 (mean square of 51 samples)."""
    rng = np.random.default_rng(11)
    sweep = several_lines(rng, sweeps=1, iq=iq)[0]
    found = demanded(joint_lines(sweep, Receiver(2e6)))
    strongest = found.frequency[np.argsort(-np.abs(found.phasor))[:4]]
    assert np.allclose(np.sort(strongest), [0.05, 0.11, 0.17, 0.23], atol=2e-4)
    assert found.held_out < 2.5 * 2.0**2


def test_lines_before_a_limit_and_a_high_pass_are_described_as_they_were():
    """Behind what the plateaus show, two lines leave a fifth of what two lines leave of the samples themselves."""
    m = drooping()
    found = limit(m)
    receiver = Receiver(m.rate, found.level, found.pole[0])
    plain, behind = (joint_lines(m.signal[0], x, 2)[2] for x in (Receiver(m.rate), receiver))
    assert behind.held_out < 0.2**2 * plain.held_out
    assert np.allclose(np.sort(np.abs(behind.frequency)) * m.rate, [50.0, 130.0], atol=0.1)
    assert np.allclose(np.sort(np.abs(behind.phasor)), [1e4, 3e4], rtol=0.1)
    fit, _, _ = limited_fit(m, found)
    assert fit.held_out.after < 0.2**2 * fit.held_out.before


def test_bursts_are_counted():
    """In 20 of 40 sweeps 30 samples of noise 20 dB above that of the receiver."""
    rng = np.random.default_rng(3)
    x = several_lines(rng)
    for row in rng.permutation(40)[:20]:
        first = rng.integers(40, 220)
        x[row, first : first + 30] += 20.0 * (rng.normal(size=30) + 1j * rng.normal(size=30))
    found = bursts(scene(x))
    assert found.probability == 0.5
    assert 0.5 < found.duration / 15e-6 < 1.5
    assert abs(20.0 * math.log10(found.amplitude / (20.0 * math.sqrt(2.0)))) < 3.0


@pytest.mark.parametrize('size', [(0.4, 0.0), (0.0, 3.0), (-0.5, -2.0)])
def test_an_imbalance_shows_in_the_images_of_moving_lines(size):
    """Gain and phase within 5 standard deviations, of one seed."""
    gain, phase = 10.0 ** (size[0] / 20.0), math.radians(size[1])
    x = several_lines(np.random.default_rng(4))
    x = x.real + 1j * gain * (x.imag * math.cos(phase) - x.real * math.sin(phase))
    found = image(scene(x))
    std = max(2.0 * found.std, 1e-4)
    assert abs(found.gain - size[0]) < 5.0 * 8.7 * std + 0.02
    assert abs(found.phase - size[1]) < 5.0 * math.degrees(std) + 0.1


def test_an_imbalance_of_a_single_line_is_named(tmp_path):
    effect = {'effect': 'iq_imbalance', 'gain': 0.5, 'phase': 2.0}
    found = diagnose(looped_back(tmp_path / 'r', sweeps=12, iq=True, effects=(effect,)))
    (named,) = found.explanation.effects
    assert named.effect == 'iq_imbalance'
    assert abs(named.parameters['gain'].value - 0.5) < 0.05
    assert abs(named.parameters['phase'].value - 2.0) < 0.3


@pytest.mark.parametrize('iq', [False, True])
def test_a_target_that_walks_is_followed_among_returns_that_stand(iq):
    """It goes from 12 to 40 cells and back, 30 dB below a return that stands and flickers; within one cell, 95 %."""
    rng = np.random.default_rng(12)
    time, sweep = np.arange(512) / 512.0, np.arange(400)[:, None]
    cells = 26.0 - 14.0 * np.cos(2.0 * np.pi * sweep / 400.0)
    flicker = 1.0 + 1e-3 * rng.normal(size=(400, 1))
    x = 1000.0 * flicker * np.exp(2j * np.pi * 20.3 * time) + 30.0 * np.exp(2j * np.pi * (cells * time + 9.0 * cells))
    x = x + 3e3 * np.exp(-time / 0.1) + rng.normal(size=x.shape) + 1j * rng.normal(size=x.shape)  # a slow skirt of 0 Hz
    found = track(scene(x if iq else np.rint(x.real), 8192.0))
    at = found.path / 299792458.0 * 1e9
    expected = np.interp(found.sweep, sweep[:, 0], cells[:, 0])
    assert np.mean(np.abs(at - expected) < 1.0) > 0.95


def test_a_dead_time_of_the_paths_delay_is_no_window(tmp_path):
    """The first samples hold no echo of the ramp, which the nominal model knows."""
    data = read_dataset(looped_back(tmp_path / 'r', (900.0,)))
    found = ramp(material(data))
    assert found is None or found.narrower == (False, False)
    assert dataclasses.asdict(material(data))['station'] == 'radar'


def test_the_remainder_that_was_measured_is_simulated(tmp_path):
    """What repeats in 30 sweeps of two patterns that vary comes back within 2 standard deviations of the noise."""
    data = read_dataset(looped_back(tmp_path / 'r', sweeps=30))
    rng, shape = np.random.default_rng(8), data.samples_of(0).shape
    t, n = np.arange(shape[1]), np.arange(shape[0])[:, None]
    ripples = 300.0 * np.cos(2e-4 * t**1.5) + (200.0 + 2.0 * n) * np.sin(0.03 * t) * np.exp(-t / 700.0)
    samples = np.rint(ripples + rng.normal(0.0, 3.0, shape)).astype(np.int16)
    data = dataclasses.replace(data, samples=(samples,))
    m = material(data)
    found = background(m)
    write_measured(tmp_path / 'measured.npz', measured(data, m, found, ()))
    path = write_refined(tmp_path / 'refined.yaml', data, (), None, m)
    played = read_dataset(record(read_scenario(path), tmp_path / 'played'))
    rest = played.samples_of(0).astype(float) - ripples
    assert float(np.sqrt(np.mean(rest**2))) < 2.0 * 3.0
