"""The generator of the challenge: independent of what it judges, right by closed forms, sealed, reproducible."""

import ast
import dataclasses
import hashlib
import itertools
import json
import math
import os
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from checkout import practice_recording
from scipy import special, stats
from scipy.integrate import cumulative_trapezoid, trapezoid

import drfmcw_proof
from drfmcw_diagnosis.next.ranking import measurements
from drfmcw_physics.air import refractive_index
from drfmcw_physics.link_budget import received_power
from drfmcw_physics.sweep import SweepSettings
from drfmcw_proof.cases import concealing as effects
from drfmcw_proof.cases import draws, sizes
from drfmcw_proof.cases import plan as cases
from drfmcw_proof.cases.carried_out import carried_out
from drfmcw_proof.cases.concealing import Applied, conceal
from drfmcw_proof.cases.covering import covering
from drfmcw_proof.generator import model as generator
from drfmcw_proof.generator import recordings
from drfmcw_proof.generator.condition import Condition, StationCondition
from drfmcw_proof.generator.model import FIRST, SECOND, clean, nominal
from drfmcw_ros.bag.files import BagReader
from drfmcw_sim.effects import Effect
from drfmcw_sim.measurements import Measurements, Station
from drfmcw_sim.measurements import Path as WavePath
from drfmcw_sim.synthesis import signal_model

PACKAGE = Path(drfmcw_proof.__file__).parent
ROOMS = ('generator', 'cases')
BOTH = (FIRST, SECOND)


def condition(distances=(60.0, 300.0, 900.0), sweeps=4, stations=None, board=(35.0, 30.0), **changes):
    """Return a small condition in ordinary weather."""
    n = len(distances)
    fields = {
        'seed': 7,
        'air_temperature': (15.0,) * n,
        'air_pressure': (101325.0,) * n,
        'air_humidity': (0.5,) * n,
        'board_temperature': tuple((b,) * n for b in board),
    }
    if stations is not None:
        fields['stations'] = stations
    return Condition(distances=distances, sweeps=sweeps, **{**fields, **changes})


def quiet(c):
    """Return the condition without noise worth the name."""
    stations = tuple(dataclasses.replace(s, noise_floor=-250.0, phase_noise_level=-250.0) for s in c.stations)
    return dataclasses.replace(c, stations=stations, reference_std=0.0)


def with_effect(c, effect, station=None, **parameters):
    """Return the scene with and the scene without an effect."""
    return conceal(nominal(c), [Applied(effect, station, parameters)]), nominal(c)


def phase_change(scene, before, station, rows):
    """Return what an effect adds to the IF phase [rows, samples] [rad], NaN where a chirp is off."""
    new, old = clean(scene, station, rows), clean(before, station, rows)
    on = (new != 0.0) & (old != 0.0)
    ratio = np.where(on, new / np.where(on, old, 1.0), 1.0)
    return np.where(on, np.unwrap(np.angle(ratio)), np.nan)


def slope(change):
    """Return the frequency [rows] [Hz] of phases, between the same samples of each."""
    return (change[:, 2000] - change[:, 100]) * 2.048e6 / 1900 / (2.0 * math.pi)


# --- independence ---


def within(path, node):
    """Return whether a relative import of a module in `path` stays in the rooms of the generator and its cases."""
    target = path.parents[node.level - 1].joinpath(*(node.module or '').split('.'))
    return target.relative_to(PACKAGE).parts[0] in ROOMS


def test_modules_import_nothing_they_judge():
    allowed = {'numpy', 'scipy', *sys.stdlib_module_names}
    files = [path for room in ROOMS for path in sorted((PACKAGE / room).glob('*.py'))]
    assert len(files) >= 6
    for path in files:
        for node in ast.walk(ast.parse(path.read_text(encoding='utf-8'))):
            if isinstance(node, ast.Import):
                assert all(a.name.split('.')[0] in allowed for a in node.names), path.name
            elif isinstance(node, ast.ImportFrom):
                name = str(node.module)
                outside = name.split('.')[0] in allowed or name == 'drfmcw_ros.bag.files'
                assert outside if node.level == 0 else within(path, node), (path.name, name)
            elif isinstance(node, ast.Call) and isinstance(node.func, ast.Name | ast.Attribute):
                assert getattr(node.func, 'id', getattr(node.func, 'attr', '')) not in ('import_module', '__import__')


def test_what_is_loaded_holds_no_forward_model():
    code = 'import sys, drfmcw_proof.cases.plan; print([m for m in sys.modules if m.startswith("drfmcw")])'
    out = subprocess.run([sys.executable, '-c', code], capture_output=True, text=True, check=True, env=dict(os.environ))
    loaded = set(ast.literal_eval(out.stdout))
    rooms = tuple(f'drfmcw_proof.{room}' for room in ROOMS)
    own = {m for m in loaded if m == 'drfmcw_proof' or m.startswith(rooms)}
    # the bag's plumbing declares settings; nothing that computes is among these
    assert {m for m in loaded - own if not m.startswith('drfmcw_ros')} <= {'drfmcw_physics', 'drfmcw_physics.settings'}


# --- the nominal model ---


def as_simulated(scene, rows, velocity):
    """Return the simulator's measurements of the same truth."""
    c, n = scene.condition, len(rows)
    stations = []
    for i, (name, peer) in enumerate((('master', 'slave'), ('slave', 'master'))):
        sweep = SweepSettings(name, peer, role=i + 1, mode=1, start_delay=c.long_start_delay)
        zero = np.zeros(n)
        stations.append(
            Station(sweep, scene.alpha[i, rows], scene.clock[i, rows], zero, zero, None, scene.board[i, rows])
        )
    slowness = (1.0 + 1e-6 * scene.refractivity[rows]) / 299792458.0
    far = scene.range_at(rows, scene.time[rows])
    path = WavePath(scene.delay[rows] + far * slowness, velocity * slowness, np.zeros(n), np.ones(n))
    return Measurements(
        tuple(stations), rows, scene.time[rows], far, velocity, scene.start_delay[rows], scene.phase[:, rows], [path]
    )


@pytest.mark.parametrize('seed', range(6))
def test_phases_agree_with_the_simulator(seed):
    random = np.random.default_rng(seed)
    alphas = 1.0 + random.uniform(-40e-6, 40e-6, 2)
    clocks = 1.0 + random.uniform(-40e-6, 40e-6, 2)
    stations = tuple(
        StationCondition(name, float(random.uniform(5e-9, 300e-9)), float(a), float(b))
        for name, a, b in zip(('master', 'slave'), alphas, clocks, strict=True)
    )
    c = condition(tuple(random.uniform(20.0, 1900.0, 4)), 3, stations, mode_boundary=0.0)
    velocities = random.uniform(-5.0, 5.0, 4) * (seed % 2)
    scene = conceal(nominal(c), [Applied('target_motion', None, {'velocity': list(velocities)})] if seed % 2 else [])
    rows = np.arange(len(scene))
    m = as_simulated(scene, rows, velocities[scene.setting])
    for station in BOTH:
        ours = generator.heard(scene, station, rows, scene.rays[0]).turns
        geometry = signal_model.geometry(m, station, m.paths[0])
        apart = ours - signal_model.if_phase(m, station, geometry) * signal_model.PHASE_UNIT
        apart -= np.rint(apart)
        assert 2.0 * math.pi * np.max(np.abs(apart)) < 1e-6
        on = clean(scene, station, rows) != 0.0
        first, end = signal_model.overlap(m, station, geometry)
        numbers = np.arange(c.sample_count)
        assert np.array_equal(on, (numbers >= first[:, None]) & (numbers < end[:, None]))


def test_weather_and_link_budget_agree_with_the_standards():
    random = np.random.default_rng(1)
    t, p, h = random.uniform(-20, 40, 50), random.uniform(95e3, 105e3, 50), random.random(50)
    assert np.allclose(generator.refractivity(t, p, h), 1e6 * (refractive_index(t, p, h) - 1.0), atol=1e-6)
    c = condition(amplitude_scatter=0.0)
    scene = nominal(c)
    power = received_power(c.tx_eirp, c.rx_antenna_gain, scene.distance, 5.8e9)
    amplitude = scene.amplitude(FIRST, np.arange(len(scene)))
    assert np.allclose(20.0 * np.log10(amplitude / 8192.0) - 20.0, power, atol=1e-9)


def test_lines_stand_where_the_interface_says():
    c = quiet(condition(start_delay_jitter=0.0))
    scene = nominal(c)
    rows = np.arange(len(scene))
    air = (1.0 + 1e-6 * scene.refractivity) / 299792458.0
    tau = 27e-9 + scene.distance * air
    for station, sign in (FIRST, 1.0), (SECOND, -1.0):
        phase = np.unwrap(np.angle(clean(scene, station, rows)[:, 100:2001]))
        measured = (phase[:, -1] - phase[:, 0]) * 2.048e6 / 1900 / (2.0 * math.pi)
        assert np.allclose(measured, 150e9 * (tau + sign * scene.start_delay), atol=1e-3)


@pytest.mark.parametrize('kind, value', [('one_pole', 0.0), ('bump', 6.0), ('corner', 2.0), ('plateau', 2.0)])
def test_phase_noise_has_the_density_asked_for(kind, value):
    c = condition((60.0,), 256, start_delay_jitter=0.0)
    shape = generator.NoiseShape(kind, value)
    stations = tuple(dataclasses.replace(s, shape=shape) for s in c.stations)
    scene = nominal(dataclasses.replace(c, stations=stations))
    rows = np.arange(256)
    lag = np.full(256, 3.7e-6)
    noise = generator._Oscillators(scene, rows, np.random.default_rng(3)).difference(FIRST, lag)
    window = np.blackman(2048)
    power = np.mean(np.abs(np.fft.rfft(noise * window)) ** 2, axis=0) / np.sum(window**2) / 2.048e6
    frequency = np.fft.rfftfreq(2048, 1.0 / 2.048e6)
    # two-sided densities of two independent oscillators add; 48 bins x 256 sweeps scatter by 1 %: 5 sigma is 1e-6
    expected = 2.0 * generator.phase_noise_density(frequency, -90.0, 120e3, shape)
    for low in range(16, 1000, 48):
        assert np.mean(power[low : low + 48] / expected[low : low + 48]) == pytest.approx(1.0, abs=0.06)
    assert 10.0 * math.log10(generator.phase_noise_density(np.array(1e5), -90.0, 120e3, generator.NoiseShape())) == (
        pytest.approx(-90.0)
    )


def test_pair_s_phase_noise_cancels_in_the_sum():
    c = condition((60.0,), 64)
    scene = nominal(c)
    rows = np.arange(64)
    oscillators = generator._Oscillators(scene, rows, np.random.default_rng(4))
    tau = 0.3e-6
    first = oscillators.difference(FIRST, np.full(64, tau + 2e-6))
    second = oscillators.difference(SECOND, np.full(64, tau - 2e-6))
    shift = 2e-6 * 2.048e6  # station 2's record begins later
    spectrum = np.fft.rfft(second * np.hanning(2048)) * np.exp(-2j * math.pi * np.fft.rfftfreq(2048) * shift)
    both = np.abs(np.fft.rfft(first * np.hanning(2048)) + spectrum) ** 2
    one = np.abs(spectrum) ** 2
    band = slice(50, 100)
    gain = np.mean(both[:, band]) / np.mean(one[:, band])
    frequency = np.fft.rfftfreq(2048, 1.0 / 2.048e6)[band]
    # the sum is p1(t) - p1(t - 2 tau') ... of both oscillators: 4 sin^2(2 pi f tau / 2) of each
    assert gain == pytest.approx(np.mean(4.0 * np.sin(math.pi * frequency * tau) ** 2), rel=0.3)


# --- effects ---

ON_BOTH = ('ramp_window', 'frequency_modulation')  # of the ramp that both receive
REAL_IF_LACKS = {'iq_imbalance'}
"""Effects of the interface that only quadrature receivers have; the generator's IF is real."""


def test_names_and_parameters_are_the_interface_s():
    assert set(effects.REGISTERED) == set(Effect.registry) - REAL_IF_LACKS
    assert len(effects.OUTSIDE) >= 8
    for name in effects.REGISTERED:
        kind, simulated = effects.KINDS[name], Effect.registry[name]
        assert kind.of == simulated.of
        assert set(kind.units) - {'phase'} <= {f.name for f in dataclasses.fields(simulated)}


@pytest.mark.parametrize('effect', effects.REGISTERED + effects.OUTSIDE)
def test_every_effect_changes_its_own_station_or_all(effect):
    c = condition(board=(36.0, 29.0))
    c = dataclasses.replace(c, board_temperature=((30.0, 34.0, 38.0), (31.0, 29.0, 37.0)), full_scale_power=-40.0)
    random = np.random.default_rng(5)
    applied = draws.template(random, effect, c)
    assert conceal(nominal(c), applied)  # of any size
    last = dataclasses.replace(applied[-1], station='slave' if effects.KINDS[effect].of == 'station' else None)
    if effect == 'phase_noise':
        last = dataclasses.replace(last, parameters={'level': -80.0})
    if effect == 'interference_burst':
        last = dataclasses.replace(last, parameters={**last.parameters, 'probability': 1.0})
    before, after = conceal(nominal(c), applied[:-1]), conceal(nominal(c), [*applied[:-1], last])
    old, new = generator.render(before), generator.render(after)
    changed = [not np.array_equal(a, b) for a, b in zip(old, new, strict=True)]
    of, name = effects.KINDS[effect].of, effect
    if of == 'reference':
        assert changed == [False, False]
        assert not np.array_equal(before.reference(), after.reference())
    elif effect in ON_BOTH:
        assert changed == [True, True]
    elif last.station is None or after.chirp[SECOND] or 'clock' in name or 'delay' in name or 'step' in name:
        assert changed[SECOND]
    elif name == 'phase_noise':
        assert changed == [True, True]
    else:
        assert changed == [False, True]


SHAPES = {
    'sweep_curvature': ({'deviation': 700.0}, lambda t: 700.0 * (1.0 - (2.0 * t / 1e-3 - 1.0) ** 2)),
    'sweep_ripple': (
        {'deviation': 300.0, 'rate': 7e3, 'phase': 0.4},
        lambda t: 300.0 * np.sin(2.0 * math.pi * 7e3 * t + 0.4),
    ),
    'pll_settling': (
        {'step': 4e4, 'natural_frequency': 15e3, 'damping': 0.4},
        lambda t: (
            4e4 * np.exp(-2.0 * math.pi * 0.4 * 15e3 * t) * np.cos(2.0 * math.pi * 15e3 * math.sqrt(1.0 - 0.16) * t)
        ),
    ),
}


@pytest.mark.parametrize('effect', SHAPES)
@pytest.mark.parametrize('station', BOTH)
def test_sweep_shapes_are_integrals_of_the_frequency_error(effect, station):
    parameters, error = SHAPES[effect]
    c = quiet(condition())
    scene, before = with_effect(c, effect, c.names[station], **parameters)
    rows = np.array([0, 5, 11])
    t = np.linspace(0.0, 1e-3, 200_001)
    phase = 2.0 * math.pi * cumulative_trapezoid(error(t), t, initial=0.0)
    u = np.arange(2048) / 2.048e6
    own = phase_change(scene, before, station, rows)
    expected = np.broadcast_to(np.interp(u, t, phase), own.shape)
    assert np.nanmax(np.abs(_level(own - expected))) < 2e-5
    lag = generator.heard(scene, 1 - station, rows, scene.rays[0]).lag
    peer = phase_change(scene, before, 1 - station, rows)
    heard = -np.interp(u - lag[:, None], t, phase)
    assert np.nanmax(np.abs(_level(peer - heard))) < 2e-5


def _level(difference):
    """Return phases without whole turns."""
    return difference - 2.0 * math.pi * np.rint(difference / (2.0 * math.pi))


DELAYS = {
    'delay_offset': ({'delay': 0.3}, lambda s: 0.3e-9),
    'delay_temperature': ({'slope': 20.0}, lambda s: 20e-12 * (30.0 - 25.0)),
    'air_refractivity': ({'offset': 40.0}, lambda s: 40e-6 * s.distance / 299792458.0),
    'slant_geometry': (
        {'height_difference': 6.0},
        lambda s: (np.hypot(s.distance, 6.0) - s.distance) * (1.0 + 1e-6 * s.refractivity) / 299792458.0,
    ),
}


@pytest.mark.parametrize('effect', DELAYS)
def test_delays_move_both_lines_alike(effect):
    parameters, delay = DELAYS[effect]
    c = quiet(condition())
    scene, before = with_effect(c, effect, 'slave' if effects.KINDS[effect].of == 'station' else None, **parameters)
    rows = np.arange(len(scene))
    for station in BOTH:
        moved = slope(phase_change(scene, before, station, rows))
        assert np.allclose(moved, 150e9 * delay(before), atol=1e-2)


def test_references_bend_lines_and_move_the_adc():
    c = quiet(condition((200.0,), 2))
    for effect, parameters, ppm in (
        ('reference_clock_offset', {'deviation': 3.0}, 3.0),
        ('reference_clock_temperature', {'slope': 0.5}, 2.5),
        ('frequency_step', {'step': 3.0, 'temperature': 28.0}, 3.0),
    ):
        scene, before = with_effect(c, effect, 'slave', **parameters)
        assert np.allclose(scene.alpha[SECOND], 1.0 + 1e-6 * ppm, atol=1e-15)
        assert np.allclose(scene.clock[SECOND], 1.0 + 1e-6 * ppm, atol=1e-15)
        # the master's line: -f_0 ppm, and the chirp rate's share of both times; residual chirp -2 k ppm t
        change = phase_change(scene, before, FIRST, np.array([0]))[0] / (2.0 * math.pi)
        bend = change[100] - 2.0 * change[1050] + change[2000]
        assert bend == pytest.approx(-2e-6 * ppm * 150e9 * (950 / 2.048e6) ** 2, rel=1e-3)
    scene, before = with_effect(c, 'reference_clock_drift', 'master', warmup=2.0, time_constant=0.05)
    assert np.allclose(scene.alpha[FIRST], 1.0 + 2e-6 * np.exp(-scene.time / 0.05), atol=1e-15)
    scene, before = with_effect(c, 'reference_clock_drift', 'master', rate=3600.0)
    assert np.allclose(scene.alpha[FIRST], 1.0 + 1e-6 * scene.time, atol=1e-15)
    scene, before = with_effect(c, 'sample_clock_offset', 'slave', deviation=50.0)
    assert np.array_equal(scene.alpha, before.alpha)
    line = np.abs(slope(np.unwrap(np.angle(clean(before, SECOND, np.array([0]))))))
    moved = np.abs(slope(np.unwrap(np.angle(clean(scene, SECOND, np.array([0]))))))
    assert moved / line == pytest.approx(1.0 - 50e-6, abs=1e-8)


def test_second_rays_interfere():
    c = quiet(condition())
    rows = np.arange(len(nominal(c)))
    n = 1.0 + 1e-6 * nominal(c).refractivity
    for effect, parameters, excess, gain in (
        ('echo', {'excess_range': 9.0, 'relative_power': -30.0}, 9.0 + 0.0 * n, 10.0**-1.5),
        (
            'echo',
            {'excess_range': 9.0, 'relative_power': -30.0, 'phase': 1.3},
            9.0 + 0.0 * n,
            10.0**-1.5 * np.exp(1.3j),
        ),
        (
            'ground_reflection',
            {'height_product': 60.0, 'coefficient': 0.2},
            np.hypot(nominal(c).distance, math.sqrt(240.0)) - nominal(c).distance,
            -0.2,
        ),
    ):
        scene, before = with_effect(c, effect, **parameters)
        longer = excess * n / 299792458.0
        for station in BOTH:
            new, old = clean(scene, station, rows), clean(before, station, rows)
            u = np.arange(2048) / 2.048e6
            d = generator.heard(before, station, rows, before.rays[0]).lag
            # 2 pi (f of the peer when the direct ray was sent) times the excess, less the chirp within it
            turns = longer[:, None] * (5.725e9 + 150e9 * (u - d[:, None])) - 0.5 * 150e9 * longer[:, None] ** 2
            expected = 1.0 + gain * np.exp(2j * math.pi * turns)
            inner = slice(60, 1980)
            assert np.allclose((new / np.where(old == 0, 1, old))[:, inner], expected[:, inner], atol=1e-6)


def test_levels_of_what_is_added_or_lost():
    c = quiet(condition((60.0, 800.0), 8, full_scale_power=-40.0))

    def samples(effect, **parameters):
        applied = Applied(effect, 'slave' if effects.KINDS[effect].of == 'station' else None, parameters)
        return generator.render(conceal(nominal(c), [applied]))[SECOND].astype(float)

    plain = generator.render(nominal(c))[SECOND].astype(float)
    lost = samples('amplitude_loss', loss=3.0, specific=5.0)
    ratio = 20.0 * np.log10(np.std(lost, axis=1) / np.std(plain, axis=1))
    assert np.allclose(ratio, np.repeat([-3.3, -7.0], 8), atol=0.02)
    assert np.allclose(np.mean(samples('tx_leakage', level=-40.0) - plain, axis=1), 81.92, atol=0.1)
    line = samples('spur', frequency=3e5, level=-40.0) - plain
    spectrum = np.abs(np.fft.rfft(line)) / 1024
    assert np.allclose(spectrum[:, 300], 81.92, rtol=0.01)
    phases = np.angle(np.fft.rfft(line)[:, 300])
    assert np.ptp(phases) > 0.5  # free-running; 16 phases within 0.5 rad: probability below 1e-15
    clipped = samples('clipping', level=-20.0)
    assert np.max(np.abs(clipped)) == round(819.2)
    assert np.array_equal(clipped, np.clip(plain, -819, 819))
    bent = samples('compression', third_order=0.3)
    assert np.allclose(bent, plain * (1.0 - 0.3 * (plain / 8192.0) ** 2), atol=2.5)
    settling = samples('receiver_settling', level=-40.0, time_constant=1e-4) - plain
    assert np.allclose(settling, 81.92 * np.exp(-np.arange(2048) / 204.8), atol=1.5)
    noisy = dataclasses.replace(c, stations=(c.stations[0], dataclasses.replace(c.stations[1], noise_floor=-130.0)))
    quiet_part = slice(2042, 2048)  # the master's chirp is over: nothing but noise, 16 x 6 samples of 5 % scatter
    raised = generator.render(conceal(nominal(noisy), [Applied('noise_floor', 'slave', {'excess': 10.0})]))[SECOND]
    assert np.std(raised[:8, quiet_part]) == pytest.approx(
        8192.0 * math.sqrt(0.5) * 10.0 ** ((-120.0 + 60.103 + 40.0) / 20.0), rel=0.4
    )


def test_bursts_come_as_often_and_as_strong_as_said():
    c = quiet(condition((60.0,), 400))
    burst = {'probability': 0.3, 'level': -40.0, 'duration': 1e-4}
    new = generator.render(conceal(nominal(c), [Applied('interference_burst', 'master', burst)]))[FIRST].astype(float)
    change = new - generator.render(nominal(c))[FIRST]
    hit = np.any(np.abs(change) > 2.0, axis=1)
    assert abs(np.mean(hit) - 0.3) < 5.0 * math.sqrt(0.21 / 400)  # 6e-7 by chance
    inside = [row[np.flatnonzero(np.abs(row) > 2)[0] : np.flatnonzero(np.abs(row) > 2)[-1] + 1] for row in change[hit]]
    assert max(map(len, inside)) <= math.ceil(204.8)
    power = np.mean(np.concatenate([i for i in inside if len(i) > 150]) ** 2)
    assert power == pytest.approx(0.5 * 81.92**2, rel=0.06)  # 5000 samples at the least: 2 % scatter


def test_if_filter_is_a_first_order_low_pass_and_meets_no_step():
    c = quiet(condition((60.0, 300.0), 2))
    for pole in (3e5, 5e6):
        scene, before = with_effect(c, 'if_filter', 'master', pole=pole)
        rows = np.arange(len(scene))
        new, old = clean(scene, FIRST, rows), clean(before, FIRST, rows)
        line = sizes._line(before, FIRST, rows)
        expected = 1.0 / (1.0 + 1j * line / pole)
        inner = slice(80, 1980)
        assert np.allclose((new / np.where(old == 0, 1, old))[:, inner], expected[:, None], atol=3e-4)
        # first samples of the signal: settled response less the exponential from the true switching on
        on = generator.heard(before, FIRST, rows, before.rays[0]).on[0]
        u = np.arange(2048) / 2.048e6
        for row in rows:
            first = int(np.argmax(u >= on[row]))
            fade = np.exp(-(2.0 * math.pi * pole + 2j * math.pi * line[row]) * (u[first : first + 8] - on[row]))
            start = old[row, first : first + 8] * expected[row] * (1.0 - fade)
            assert np.allclose(new[row, first : first + 8], start, atol=0.02 * np.max(np.abs(start)))


def test_ac_coupling_is_a_first_order_high_pass():
    c = quiet(condition((60.0, 300.0), 2))
    rows = np.arange(4)
    step = np.ones((4, 2048))
    u = np.arange(2048) / 2.048e6
    for pole in (100.0, 5e3, 3e5):
        scene = conceal(nominal(c), [Applied('ac_coupling', 'master', {'pole': pole})])
        (hook,) = [h for _, h in scene.analogue[FIRST]]
        late = slice(100, 1948) if pole > 1e5 else slice(20, 2020)  # beside the ringing of band-limited steps
        # a band-limited step counts from half a sample before its first one
        decay = np.exp(-2.0 * math.pi * pole * (u + 0.5 / 2.048e6))
        assert np.allclose(hook(scene, FIRST, rows, step)[:, late], decay[late], atol=5e-3)
        line = np.cos(2.0 * math.pi * 4e5 * u)
        settled = np.real(1j * 4e5 / (1j * 4e5 + pole) * np.exp(2j * math.pi * 4e5 * u))
        left = np.real(pole / (1j * 4e5 + pole)) * np.exp(-2.0 * math.pi * pole * u)
        passed = hook(scene, FIRST, rows, np.tile(line, (4, 1)))
        assert np.allclose(passed[:, late], (settled + left)[late], atol=8e-3)


def test_motion_turns_the_carrier_and_the_reference_follows_only_what_it_sees():
    c = quiet(condition((100.0, 400.0), 4))
    rows = np.arange(8)
    scene, before = with_effect(c, 'target_motion', velocity=[0.5, -1.0])
    v = np.repeat([0.5, -1.0], 4)
    begin = np.repeat(scene.time[::4], 4)
    assert np.allclose(scene.reference(), scene.distance + v * (scene.time - begin), atol=1e-12)
    n = 1.0 + 1e-6 * scene.refractivity
    # both lines by k tau and by the Doppler shift of the frequency that is heard at mid-record
    for station in BOTH:
        moved = slope(phase_change(scene, before, station, rows))
        tau = n / 299792458.0 * v * (scene.time - begin + (1050 / 2.048e6))
        assert np.allclose(moved, 150e9 * tau + n / 299792458.0 * v * (5.725e9 + 150e9 * 1050 / 2.048e6), atol=0.3)
    scene, before = with_effect(c, 'sway', amplitude=0.01, frequency=0.4)
    assert np.array_equal(scene.reference(), before.reference())
    assert np.allclose(
        scene.range_at(rows, scene.time), scene.distance + 0.01 * np.sin(0.8 * math.pi * scene.time), atol=1e-12
    )
    motion = Applied('target_motion', None, {'velocity': [0.5, -1.0]})
    late = conceal(nominal(c), [motion, Applied('reference_lag', None, {'lag': 0.1})])
    assert np.allclose(late.reference(), late.distance + v * (late.time - begin - 0.1), atol=1e-12)
    scene, _ = with_effect(c, 'reference_offset', offset=0.02)
    assert np.allclose(scene.reference(), scene.distance + 0.02, atol=1e-12)
    scene, _ = with_effect(c, 'reference_scale', scale=50.0)
    assert np.allclose(scene.reference(), scene.distance * (1.0 + 50e-6), atol=1e-12)


def test_outside_effects_do_what_their_names_say():
    c = quiet(condition((60.0,), 4))
    plain = generator.render(nominal(c))[FIRST]

    def samples(effect, **parameters):
        return generator.render(conceal(nominal(c), [Applied(effect, 'master', parameters)]))[FIRST]

    assert np.array_equal(samples('stuck_bit', bit=4, value=1), plain | 16)
    assert np.array_equal(samples('stuck_bit', bit=4, value=0), plain & ~16)
    assert np.all(np.mod(samples('missing_codes', width=8), 16) >= 8)
    dropped = samples('dropped_samples', count=3, time=5e-4)
    assert np.array_equal(dropped[:, :1024], plain[:, :1024])
    assert np.array_equal(dropped[:, 1024:-3], plain[:, 1027:])
    assert np.array_equal(samples('gain_step', step=6.0, time=5e-4)[:, :1024], plain[:, :1024])
    jump, before = with_effect(c, 'phase_jump', 'master', angle=0.3, time=5e-4)
    change = phase_change(jump, before, FIRST, np.array([0]))[0]
    assert change[900] == pytest.approx(0.0, abs=1e-9)
    assert change[1200] == pytest.approx(0.3, abs=1e-9)


@pytest.mark.parametrize(
    'effect, station, parameters',
    [('haze', None, {}), ('echo', 'master', {}), ('spur', 'tower', {}), ('echo', None, {'loudness': 1.0})],
)
def test_unknown_effects_are_refused(effect, station, parameters):
    with pytest.raises(ValueError, match=effect):
        conceal(nominal(condition()), [Applied(effect, station, parameters)])


# --- matched sizes ---


def test_matched_sizes_have_their_closed_forms():
    c = condition((40.0, 60.0, 90.0), 16)
    silent = dataclasses.replace(
        c, stations=tuple(dataclasses.replace(s, phase_noise_level=-160.0) for s in c.stations), reference_std=0.05
    )
    offset = sizes.matched_size(silent, [Applied('reference_offset', None, {'offset': 0.03})])
    assert offset.total == pytest.approx(0.03 / 0.05 * math.sqrt(48), rel=0.01)
    twin = sizes.matched_size(silent, [Applied('delay_offset', None, {'delay': 0.03 / 0.299792458 * 1.0003})])
    assert twin.total == pytest.approx(offset.total, rel=0.01)
    noise = sizes.matched_size(silent, [Applied('noise_floor', 'slave', {'excess': 0.2})])
    assert noise.total == pytest.approx(math.sqrt(48 * 1024) * 0.2 * math.log(10.0) / 10.0, rel=0.02)
    loss = sizes.matched_size(silent, [Applied('amplitude_loss', None, {'loss': 0.1})])
    assert loss.total == pytest.approx(0.1 / 0.2 * math.sqrt(48), rel=0.02)
    halved = sizes.matched_size(silent, [Applied('amplitude_loss', None, {'loss': 10.0})])
    assert halved.amplitude == pytest.approx(10.0 / 0.2 * math.sqrt(48), rel=0.02)


def silent_pair(sweeps):
    """Return a condition of white noise alone."""
    c = condition((60.0,), sweeps, start_delay_jitter=0.0)
    stations = tuple(dataclasses.replace(s, phase_noise_level=-160.0) for s in c.stations)
    return dataclasses.replace(c, stations=stations)


def line(c, energy, frequency=2.5e5):
    """Return a spur of so much energy over the variance of white noise in the samples that are on."""
    std = float(nominal(c).noise_std(FIRST)[0])
    return Applied(
        'spur', 'master', {'frequency': frequency, 'level': 20.0 * math.log10(math.sqrt(energy / 1020) * std / 8192)}
    )


@pytest.mark.parametrize('energy', [0.02, 0.3, 2.0, 8.0, 50.0, 1000.0])
def test_line_of_unknown_phase_counts_as_its_best_detector_sees_it(energy):
    """Its amplitude has Rice's law, without it Rayleigh's: twice the divergence, on a bin and between two alike."""
    rho = math.sqrt(energy)
    x = np.linspace(0.0, rho + 12.0, 20_001)
    gain = np.log(special.i0e(rho * x)) + rho * x - 0.5 * energy
    divergence = trapezoid(stats.rice.pdf(x, rho) * gain, x)
    c = silent_pair(16)
    for frequency in (2.5e5, 2.505e5, 6.1803e5):
        size = sizes.matched_size(c, [line(c, energy, frequency)])
        assert size.total == pytest.approx(math.sqrt(2.0 * 16 * divergence), rel=0.06)  # 4 % of it by the energy
        assert size.shape < 1e-6 * size.total


def test_deflection_of_summed_powers_is_the_size_of_a_weak_line():
    c = silent_pair(2000)
    scene, _ = with_effect(c, 'spur', 'master', **line(c, 0.2).parameters)
    rows = np.arange(2000)
    noise = np.random.default_rng(2).standard_normal((2000, 2048)) * scene.noise_std(FIRST)[rows, None]
    wave = np.exp(-2j * math.pi * 2.5e5 / 2.048e6 * np.arange(2048))
    opposite = [dataclasses.replace(scene, advance=a) for a in (0.0, 0.5)]  # what noise and line share cancels
    powers = [np.abs(generator.receive(s, FIRST, rows, 0.0, noise) @ wave) ** 2 for s in opposite]
    before = np.abs(noise @ wave) ** 2
    deflection = (np.mean(powers) - np.mean(before)) / np.std(before) * math.sqrt(16)
    few = silent_pair(16)
    # the deviation of 2000 powers is known to 3 %, 5 sigma 15 %
    assert sizes.matched_size(few, [line(few, 0.2)]).total == pytest.approx(deflection, rel=0.15)


def test_lines_of_two_explanations_are_compared_by_their_powers():
    c = silent_pair(16)
    weak, strong, elsewhere = line(c, 2.0), line(c, 2.2), line(c, 2.0, 3.1e5)
    ripple = Applied('sweep_ripple', 'slave', {'deviation': 60.0, 'rate': 9e3, 'phase': 1.0})
    assert sizes.separation(c, [weak, ripple], [ripple, weak]) < 1e-4
    apart = math.sqrt(16) * 0.5 * (2.2 - 2.0) / (1.0 + 0.5 * 2.1)
    assert sizes.separation(c, [weak], [strong]) == pytest.approx(apart, rel=0.05)
    assert sizes.separation(c, [strong], [weak]) == pytest.approx(apart, rel=0.05)
    alone = sizes.separation(c, [], [weak])
    assert sizes.separation(c, [weak], []) == pytest.approx(alone, rel=1e-3)
    assert sizes.separation(c, [], [weak, elsewhere]) == pytest.approx(math.sqrt(2.0) * alone, rel=0.02)
    assert sizes.separation(c, [elsewhere], [weak]) == pytest.approx(math.sqrt(2.0) * alone, rel=0.02)


@pytest.mark.parametrize('effect', ['fan_modulation', 'adc_dither'])
def test_what_comes_at_any_time_is_not_counted_as_a_known_shape(effect):
    c = condition((60.0, 300.0), 8)
    random = np.random.default_rng(3)
    (template,) = draws.template(random, effect, c)
    _, size = sizes.scaled(c, template, 10.0)
    assert size.total == pytest.approx(10.0, rel=0.03) and size.shape < 0.1 and size.noise > 9.0


def test_bursts_pay_for_the_places_where_they_could_be():
    """Weak ones count as the power of whole sweeps shows them, strong ones less the choice among the windows."""
    c = silent_pair(16)
    power = nominal(c).noise_std(FIRST)[0] ** 2

    def size(excess, probability=0.2, length=64.0):
        level = 10.0 * math.log10(2.0 * excess * power / 8192.0**2)
        burst = {'probability': probability, 'level': level, 'duration': length / 2.048e6}
        return sizes.matched_size(c, [Applied('interference_burst', 'master', burst)]).total

    assert size(0.02) == pytest.approx(0.2 * 64 * 0.02 * math.sqrt(16 / (2.0 * 2048)), rel=0.05)
    moved = math.sqrt(32.0) * math.log(1.0 + 20.0)
    assert size(20.0) == pytest.approx(math.sqrt(16 * 0.2 * (moved**2 - 2.0 * math.log(32 / 0.2))), rel=0.02)
    assert size(3.0, probability=1.0, length=2048.0) == pytest.approx(math.sqrt(16 * 1024) * math.log(4.0), rel=0.02)
    assert size(0.1) < size(1.0) < size(2.0) < size(20.0)
    weak, strong = (
        Applied('interference_burst', 'master', {'probability': 0.2, 'level': level, 'duration': 5e-5})
        for level in (-51.0, -50.0)
    )
    alone = [sizes.separation(c, [], [burst]) for burst in (weak, strong)]
    assert sizes.separation(c, [weak], [strong]) == pytest.approx(alone[1] - alone[0], rel=1e-6)


def test_filters_nearly_alike_are_not_separated():
    """Poles a per cent apart; their answers to a chirp's edge, where there is no line, count for nothing."""
    c = condition((40.0, 200.0), 16)
    one, other = (Applied('if_filter', 'slave', {'pole': pole}) for pole in (3.75e6, 3.79e6))
    assert sizes.separation(c, [one], [other]) < 1.0
    assert sizes.separation(c, [], [other]) > 3.0


@pytest.mark.parametrize('distance', [60.0, 300.0, 900.0])
def test_noise_is_whitened_to_unit_variance(distance):
    c = condition((distance,), 64)
    scene = nominal(c)
    covariance, present = sizes._covariance(scene, 0, scene)
    precision = 2.0 * np.linalg.inv(covariance) * (present[:, :, None] & present[:, None, :]) / 2.048e6 / 2048
    rows = np.arange(64)
    samples = generator.render(scene)
    g = []
    for station in BOTH:
        carrier = clean(scene, station, rows)
        on = carrier != 0.0
        g.append(sizes._relative(samples[station] - carrier.real, carrier, on))
    bands = sizes._bands(g)
    squares = np.einsum('rfi,fij,rfj->rf', np.conj(bands), precision, bands).real
    freedom = 2.0 * np.sum(present, axis=1)
    # 64 x 4000 squares scatter by 0.3 %
    inner = slice(1, 600)
    assert np.sum(squares[:, inner]) / (64 * np.sum(freedom[inner])) == pytest.approx(1.0, abs=0.02)


@pytest.mark.parametrize('effect', ['echo', 'reference_clock_drift', 'phase_noise', 'clipping', 'slant_geometry'])
def test_effects_are_scaled_to_the_wanted_size(effect):
    random = np.random.default_rng(8)
    c = draws.random_condition(random, draws.Extent(5, 8), full_scale_power=-35.0)
    (template,) = draws.template(random, effect, c)
    applied, size = sizes.scaled(c, template, 12.0)
    assert size.total == pytest.approx(12.0, rel=0.03)
    assert sizes.matched_size(c, [applied]) == size
    assert set(applied.parameters) == set(template.parameters)


def test_size_of_an_effect_does_not_count_what_is_there_already():
    c = condition((60.0, 200.0), 8)
    spur = Applied('spur', 'master', {'frequency': 2.5e5, 'level': -60.0})
    delay = Applied('delay_temperature', 'slave', {'slope': 5.0})
    assert sizes.matched_size(c, [delay], [spur]).total == pytest.approx(sizes.matched_size(c, [delay]).total, rel=1e-6)


# --- recordings and seals ---


def test_a_seal_shows_tampering(tmp_path):
    seal = recordings.seal({'effects': [], 'x': 1.5}, tmp_path / 'truth.json')
    assert seal.sha256 == hashlib.sha256(seal.path.read_bytes()).hexdigest()
    assert recordings.open_seal(seal) == {'effects': [], 'x': 1.5}
    assert [p.name for p in tmp_path.iterdir()] == ['truth.json']
    seal.path.write_bytes(seal.path.read_bytes().replace(b'1.5', b'1.6'))
    with pytest.raises(recordings.SealError, match='truth'):
        recordings.open_seal(seal)


def test_quick_list_covers_every_group_and_follows_from_its_seed():
    quick = cases.plans('quick', 3)
    assert 10 <= len(quick) <= 14
    assert {p.group for p in quick} == {'null', 'single', 'pair', 'outside', 'ambiguous', 'left_out'}
    assert quick == cases.plans('quick', 3)
    assert quick != cases.plans('quick', 4)
    few = cases.Counts(
        nulls=5, wrong_nulls=1, sizes=(5.0,), strong_sizes=(60.0,), drives=4, pairs=2, strong_pairs=1, mixtures=2,
        beside_unknown=1, outside_sizes=(10.0,), decoys=1, ambiguous=1, left_out_sizes=(20.0,),
    )  # fmt: skip
    full = cases.plans('full', 3, few)
    assert {p.group for p in full} == set(cases.GROUPS)
    for group in ('single', 'strong', 'left_out'):
        assert {p.kind for p in full if p.group == group} == set(effects.REGISTERED)
    assert {p.kind for p in full if p.group == 'outside'} == set(effects.OUTSIDE)
    assert len({p.name for p in full}) == len(full)
    with pytest.raises(ValueError, match='medium'):
        cases.plans('medium')


def test_ambiguous_cases_change_the_data_as_their_rivals_do():
    for number, kind in enumerate(cases.AMBIGUOUS):
        plan = cases._ambiguous('x', np.random.default_rng(number), kind, 14.0, draws.Extent(6, 4))
        case = cases.realise(plan)
        assert plan.rivals and plan.verdicts == ('ambiguous',)
        measured = cases.decided('y', plan)
        after = cases.realise(measured)
        assert after.effects == (() if measured.gone else case.effects)
        assert measured.verdicts == ('consistent',) if measured.gone else 'explained' in measured.verdicts
        assert after.truth()['follows'] == 'x'
        # what is searched without is no part of the truth, and all of its exact rivals
        assert not {e.effect for e in after.effects} & set(measured.without)
        if measured.without and not measured.gone:
            assert {effect for rival in plan.rivals for effect, _ in rival} <= set(measured.without)
        # the rival of opposite effect undoes the truth: what is left is small beside it
        if kind in ('delay_offset', 'reference_offset', 'delay by either board'):
            effect, station = plan.rivals[0][0]
            name = sizes._scaled_parameter(case.effects[0])
            value = case.effects[0].parameters[name]
            undone = {'delay': value * 0.299792458 / 1.00028, 'offset': value / 0.299792458 * 1.00028, 'slope': -value}
            undoing = Applied(effect, station, {effects.KINDS[effect].size.parameter: undone[name]})
            left = sizes.matched_size(plan.condition, [*case.effects, undoing])
            assert left.total < 0.1


def test_the_tool_knows_an_effect_left_out_and_only_twins_may_replace_it():
    for number, effect in enumerate(effects.REGISTERED):
        plan = cases._left_out('x', np.random.default_rng(number), effect, 20.0, draws.Extent(4, 4))
        assert plan.without == (effect,) and plan.wanted[-1].template.effect == effect
        assert all(other != effect for rival in plan.rivals for other, _ in rival)
        assert ('explained' in plan.verdicts) == bool(plan.rivals) and 'unexplained' in plan.verdicts
    c = draws.random_condition(np.random.default_rng(5), draws.Extent(5, 8))
    truth = [Applied('reference_clock_offset', 'master', {'deviation': 0.1})]
    slow = [Applied('reference_clock_drift', 'master', {'warmup': 0.1, 'time_constant': 1e6})]
    assert sizes.separation(c, slow, truth) < 0.1 < sizes.separation(c, [], truth)


def test_separation_is_a_distance():
    """Zero to itself, alike both ways; d to nothing. Small effects, so that noise and lines hardly move."""
    c = condition((60.0, 300.0), 8)
    ripple = Applied('sweep_ripple', 'master', {'deviation': 60.0, 'rate': 9e3, 'phase': 1.0})
    other = Applied('sweep_ripple', 'master', {'deviation': 66.0, 'rate': 9e3, 'phase': 1.0})
    burst = Applied('interference_burst', 'slave', {'probability': 0.2, 'level': -62.0, 'duration': 1e-4})
    size = sizes.matched_size(c, [ripple]).total
    assert sizes.separation(c, [ripple, burst], [burst, ripple]) < 1e-6 * size
    assert sizes.separation(c, [], [ripple]) == pytest.approx(size, rel=1e-6)
    assert sizes.separation(c, [other], [ripple]) == pytest.approx(0.1 * size, rel=0.02)
    assert sizes.separation(c, [ripple], [other]) == pytest.approx(0.1 * size, rel=0.02)
    assert sizes.separation(c, [burst], []) == pytest.approx(sizes.separation(c, [], [burst]), rel=1e-6)


NOT_MADE = ('phase noise of each', 'Terminate', 'Drive the crane', 'second T_off', 'times the longest', 'halfway')


def test_recommended_measurements_are_carried_out_or_said_not_to_be():
    """What each should separate and what not, where a number follows by hand."""
    c = draws.random_condition(np.random.default_rng(3), draws.Extent(6, 8))
    pairs = {
        'distance': (
            Applied('delay_offset', None, {'delay': 0.05}),
            Applied('reference_offset', None, {'offset': -0.015}),
        ),
        'clock': tuple(
            Applied('reference_clock_offset', s, {'deviation': d}) for s, d in (('master', 0.1), ('slave', -0.1))
        ),
        'board': tuple(Applied('delay_temperature', s, {'slope': 5.0}) for s in ('master', 'slave')),
    }
    separations = {}
    for measurement in measurements(('master', 'slave')):
        made = carried_out(measurement.sentence, c)
        assert (made is None) == any(words in measurement.sentence for words in NOT_MADE), measurement.sentence
        if made is not None:
            separations[measurement.sentence] = {name: made([one], [other]) for name, (one, other) in pairs.items()}
            assert made([pairs['clock'][0]], [pairs['clock'][0]]) == pytest.approx(0.0, abs=1e-6)
    for sentence, sigma in separations.items():
        counted = 'reference oscillator' in sentence or 'ADC clock' in sentence
        if counted:  # 0.1 ppm on either, to 0.01 ppm; nothing of distances
            assert sigma == pytest.approx({'distance': 0.0, 'clock': math.sqrt(2.0) * 10.0, 'board': 0.0}, abs=0.01)
        elif 'second instrument' in sentence:  # 15 mm against 1 mm + 1 ppm and the reference's 5 mm of 8 readings
            std = [
                math.hypot(1e-3 * (1.0 + 1e-3 * d), 5e-3 / math.sqrt(8.0)) for d in (c.distances[0], c.distances[-1])
            ]
            assert sigma['distance'] == pytest.approx(math.hypot(*(15e-3 / s for s in std)), rel=1e-3)
            assert sigma['clock'] == sigma['board'] == 0.0
        elif 'Repeat' in sentence or 'as many' in sentence:  # degenerate, as often as it is repeated
            assert sigma['distance'] < 0.1
            assert (sigma['clock'] > 4.0) == ('another calibrated station' in sentence)
    (heated,) = (s for sentence, s in separations.items() if 'board of master heated' in sentence)
    (still,) = (s for sentence, s in separations.items() if 'braked' in sentence)
    assert heated['board'] > still['board']


def test_a_case_is_sealed_before_it_is_recorded_and_has_the_same_bytes_again(tmp_path):
    plan = cases.plans('quick', 3)[4]
    plan = dataclasses.replace(plan, condition=dataclasses.replace(plan.condition, sweeps=2))
    seals = []

    def announce(case, seal):
        seals.append((seal.sha256, (tmp_path / 'a' / case.name).exists()))

    path, seal = cases.conceal_case(plan, tmp_path / 'a', tmp_path / 'truths', announce)
    assert seals == [(seal.sha256, False)]
    truth = recordings.open_seal(seal)
    assert truth['effects'][0]['effect'] == plan.kind
    assert truth['effects'][0]['d']['total'] == pytest.approx(16.0, rel=0.03)
    json.dumps(truth, allow_nan=False)
    again, other = cases.conceal_case(plan, tmp_path / 'b', tmp_path / 'truths_again')
    assert other.sha256 == seal.sha256
    for file in path.iterdir():
        assert file.read_bytes() == (again / file.name).read_bytes()
        assert plan.kind.encode() not in file.read_bytes()
    with BagReader(path) as bag:
        counts = {c.topic: c.msgcount for c in bag.connections}
        messages = list(bag.messages())
    modes = len({m.mode for topic, _, m in messages if topic.endswith('sweep_config')})
    for station in ('master', 'slave'):
        assert counts[f'/{station}/if_samples'] == 28
        assert counts[f'/{station}/status'] == 14
        assert counts[f'/{station}/sweep_config'] == modes == 2
        assert counts[f'/{station}/calibration'] == 1
    assert counts['/reference/range'] == 28
    samples = [m for topic, _, m in messages if topic == '/slave/if_samples']
    assert [m.sweep_id for m in samples] == list(range(28))
    assert all(len(m.samples) == 2048 and not m.iq for m in samples)
    with pytest.raises(ValueError, match='beside'):
        cases.conceal_case(plan, tmp_path / 'c', tmp_path / 'c')


# --- against recordings made by another hand ---

ANSWERS = [
    [],
    [Applied('reference_clock_offset', 'slave', {'deviation': 12.0})],
    # answers.yaml gives no phases; these two were fitted to the recordings
    [Applied('sweep_ripple', 'master', {'deviation': 500.0, 'rate': 9000.0, 'phase': 2.26})],
    [Applied('reference_clock_temperature', 'master', {'slope': -0.35})],
    [Applied('echo', None, {'excess_range': 7.5, 'relative_power': -24.0, 'phase': 1.1})],
    'motion',
    [Applied('pll_settling', 'slave', {'step': 60e3, 'natural_frequency': 18e3, 'damping': 0.35})],
    [
        Applied('delay_temperature', 'master', {'slope': 6.0}),
        Applied('clipping', 'slave', {'level': -33.0}),
    ],
    [Applied('stuck_bit', 'master', {'bit': 4, 'value': 1})],
]
NEAR = 8  # settings at which the IF phase of single samples can be followed


def curves(samples):
    """Return phase less a straight line, and log-amplitude less its mean, of the IF in 120 cells of the sweep."""
    spectrum = np.fft.fft(samples.astype(float))
    spectrum[:, 1024:] = 0.0
    spectrum[:, :8] = 0.0
    z = 2.0 * np.fft.ifft(spectrum)[:, 60:1980]
    phase = np.unwrap(np.angle(z)).reshape(len(z), 120, 16).mean(axis=2)
    level = np.log(np.abs(z)).reshape(len(z), 120, 16).mean(axis=2)
    line = np.stack([np.ones(120), np.linspace(-1.0, 1.0, 120)])
    return phase - phase @ np.linalg.pinv(line) @ line, level - level.mean(axis=1, keepdims=True)


@pytest.mark.parametrize('number', range(9))
def test_practice_recordings_are_reproduced(number):
    if not practice_recording(number).exists():
        pytest.skip('the checkout holds four of the nine practice recordings')
    with BagReader(practice_recording(number)) as bag:
        messages = {}
        for topic, _, message in bag.messages():
            messages.setdefault(topic, []).append(message)
    reading = np.array([m.range for m in messages['/reference/range']]).reshape(14, 24)
    after = 0.02 * np.arange(24)
    velocity, start = np.polyfit(after, reading.T, 1)
    moving = ANSWERS[number] == 'motion'

    def reported(topic, field):
        return tuple(float(getattr(m, field)) for m in messages[topic])

    c = Condition(
        seed=number,
        distances=tuple(float(r) for r in (start if moving else reading.mean(axis=1))),
        air_temperature=reported('/site/temperature', 'temperature'),
        air_pressure=reported('/site/pressure', 'fluid_pressure'),
        air_humidity=reported('/site/humidity', 'relative_humidity'),
        board_temperature=(reported('/master/status', 'temperature'), reported('/slave/status', 'temperature')),
    )
    concealed = [Applied('target_motion', None, {'velocity': list(velocity)})] if moving else ANSWERS[number]
    ours = generator.render(conceal(nominal(c), concealed))
    for station, name in enumerate(c.names):
        theirs = np.array([m.samples for m in messages[f'/{name}/if_samples']])
        levels = [20.0 * np.log10(np.std(x, axis=1)).reshape(14, 24) for x in (theirs, ours[station])]
        # means of 24 sweeps that scatter by 0.2 dB on either side, and by nobody knows how much more of noise: 5 sigma
        assert np.max(np.abs(levels[0].mean(axis=1) - levels[1].mean(axis=1))) < 5.0 * 0.2 * math.sqrt(2.0 / 24) + 0.1
        for a, b in zip(curves(theirs[: 24 * NEAR]), curves(ours[station][: 24 * NEAR]), strict=True):
            a, b = a.reshape(NEAR, 24, 120), b.reshape(NEAR, 24, 120)
            variance = (a.var(axis=1, ddof=1), b.var(axis=1, ddof=1))
            # some cells have a turn lost in the phase of a sweep: the median over cells, whose expectation is 0.47
            chi = np.median((a.mean(axis=1) - b.mean(axis=1)) ** 2 / ((variance[0] + variance[1]) / 24))
            assert 0.3 < chi < 0.7
            assert np.median(variance[0] / variance[1]) == pytest.approx(1.0, abs=0.15)


def test_mixtures_hold_every_pair_of_effects_together_but_twins():
    twins = {frozenset(pair) for pair in draws.TWINS.items()}
    sets = covering(effects.REGISTERED, twins)
    assert {len(s) for s in sets} == {2, 3, 4} and all(len(set(s)) == len(s) for s in sets)
    met = {frozenset(pair) for s in sets for pair in itertools.combinations(s, 2)}
    assert met == {frozenset(pair) for pair in itertools.combinations(effects.REGISTERED, 2)} - twins
    assert sets == covering(effects.REGISTERED, twins)


def test_beside_something_unknown_only_registered_effects_are_to_be_named():
    for number in range(6):
        case = cases._beside_unknown('x', np.random.default_rng(number), draws.Extent(4, 4))
        kinds = [w.template.effect for w in case.wanted]
        assert sum(kind in effects.OUTSIDE for kind in kinds) == 1 and len(kinds) >= 2
        assert 'partial' in case.verdicts and case.group == 'beside_unknown'
