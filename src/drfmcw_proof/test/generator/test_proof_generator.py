"""The generator of the challenge: independent of what it judges, right by closed forms."""

import ast
import dataclasses
import math
import os
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from proof_conditions import BOTH, condition, phase_change, quiet, slope, with_effect
from scipy.integrate import cumulative_trapezoid

import drfmcw_proof
from drfmcw_physics.air import refractive_index
from drfmcw_physics.link_budget import received_power
from drfmcw_physics.sweep import SweepSettings
from drfmcw_proof.cases import concealing as effects
from drfmcw_proof.cases import draws, side_bands
from drfmcw_proof.cases.concealing import Applied, conceal
from drfmcw_proof.generator import model as generator
from drfmcw_proof.generator.condition import StationCondition
from drfmcw_proof.generator.model import FIRST, SECOND, clean, nominal
from drfmcw_sim.effects import Effect
from drfmcw_sim.measurements import Measurements, Station
from drfmcw_sim.measurements import Path as WavePath
from drfmcw_sim.synthesis import signal_model

PACKAGE = Path(drfmcw_proof.__file__).parent
ROOMS = ('generator', 'cases')


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
        line = side_bands.signed_line(before, FIRST, rows)
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


@pytest.mark.parametrize(
    'effect, station, parameters',
    [('haze', None, {}), ('echo', 'master', {}), ('spur', 'tower', {}), ('echo', None, {'loudness': 1.0})],
)
def test_unknown_effects_are_refused(effect, station, parameters):
    with pytest.raises(ValueError, match=effect):
        conceal(nominal(condition()), [Applied(effect, station, parameters)])
