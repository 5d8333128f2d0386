"""Effects on paths, motion, clocks, noise and the reference, against their closed forms."""

import math

import numpy as np
import pytest
from effect_scenes import BOTH_ON, CENTER, CHIRP, RATE, SEED, C, analogue, combined, made, measured, prepared, sized
from scenes import scene

from drfmcw_physics.settings import ConfigurationError
from drfmcw_sim.synthesis.signal_model import synthesise
from drfmcw_sim.timeline import Timeline

# --- paths and motion ---


def path_delay(m, effects, path=0):
    """Delay that effects add to the direct path, or that another path has beyond it [n] [s]."""
    whole = prepared(m, effects)
    return whole.paths[path].delay - (m.paths[0].delay if path == 0 else whole.paths[0].delay)


def test_refractivity_is_millimetres_per_kilometre():
    """One N-unit more, one millimetre of air per kilometre more, as if the weather had been that."""
    m = measured(2, 1000.0, waveform={'iq': True})
    effects = made([sized('air_refractivity', offset=10.0)])
    assert path_delay(m, effects) * C == pytest.approx(10e-3, rel=1e-9)
    assert prepared(m, effects).refractive_index == pytest.approx(m.refractive_index + 10e-6, rel=1e-12)
    assert combined(m, effects) == pytest.approx(10e-3 / m.refractive_index, rel=1e-4)
    driving = measured(3, 500.0, speed=10.0, start=500)
    rate = prepared(driving, effects).paths[0].rate - driving.paths[0].rate
    assert rate * C == pytest.approx(driving.velocity * 10e-6, rel=1e-6)


def test_ground_reflection_is_the_longer_side():
    """Length sqrt(R^2 + 4 h1 h2) of air, sign reversed, and moving as that length does."""
    effects = made([sized('ground_reflection', height_product=60.0, coefficient=0.3)])
    for distance in (15.0, 100.0, 1000.0):
        m = measured(1, distance)
        excess = math.sqrt(distance**2 + 240.0) - distance
        assert path_delay(m, effects, 1) == pytest.approx(excess * m.refractive_index / C, rel=1e-9)
        assert prepared(m, effects).paths[1].amplitude == pytest.approx(-0.3)
    m = measured(60, 40.0, speed=3.0, start=20)  # speeds up, then drives evenly
    whole = prepared(m, effects)
    path = whole.paths[1]
    for t in (0.5e-3, 10e-3):
        r = m.range + m.velocity * t + 0.5 * m.paths[0].acceleration * C / m.refractive_index * t * t
        hardware = m.paths[0].delay - m.range * m.refractive_index / C
        expected = hardware + np.sqrt(r * r + 240.0) * m.refractive_index / C
        length = path.delay + path.rate * t + 0.5 * path.acceleration * t * t
        assert np.max(np.abs(length - expected)) < 1e-2 * t**3 / C + 1e-21  # what the parabola leaves out


def test_two_paths_interfere():
    """What the second path adds is -coefficient times the signal over the longer path alone."""
    m = measured(2, waveform={'iq': True})
    effects = made([sized('ground_reflection', height_product=60.0, coefficient=0.3)])
    longer = m.rows(slice(None))
    longer.paths[0].delay = prepared(m, effects).paths[1].delay
    for nominal, both, alone in zip(analogue(m), analogue(m, effects), analogue(longer), strict=True):
        amplitude = np.abs(nominal[0, 1000])
        assert np.max(np.abs((both - nominal + 0.3 * alone)[:, BOTH_ON])) < 1e-6 * amplitude


@pytest.mark.parametrize('homodyne', [False, True])
def test_phase_of_an_echo_is_that_of_a_longer_way(homodyne):
    """An echo of excess L and phase 2 pi f_c dL / c is one of L + dL at both stations, but for the delay of dL.

    The frequency that is heard lies within 75 MHz of the centre f_c: a fifth of a wave is 1.3 % of 2 pi / 5 off there.
    """
    m = measured(2, waveform={'iq': True}, homodyne=homodyne)
    wave = C / m.refractive_index[0] / CENTER
    echo = {'effect': 'echo', 'excess_range': 7.5, 'relative_power': -20.0}
    longer = made([echo | {'excess_range': 7.5 + 0.2 * wave}])
    turned = made([echo | {'phase': 0.4 * math.pi}])
    opposite = made([echo | {'phase': -0.4 * math.pi}])
    for nominal, way, phase, wrong in zip(*(analogue(m, e) for e in ((), longer, turned, opposite)), strict=True):
        way, phase, wrong = (s[:, BOTH_ON] - nominal[:, BOTH_ON] for s in (way, phase, wrong))
        angle = np.angle(way * np.conj(phase))
        assert np.max(np.abs(angle)) < 1.1 * 0.4 * math.pi * 75e6 / CENTER
        assert np.max(np.abs(np.mean(angle, axis=1))) < 2e-3  # at the centre nothing is left
        assert np.min(np.abs(np.angle(way * np.conj(wrong)))) > 2.0


def test_motion_shifts_the_combined_beat_frequency():
    """f_c / k = 38.67 mm of range per m/s, and the way until the window's centre, 0.50 mm."""
    m = measured(2, waveform={'iq': True}, alphas=(1.0, 1.0))
    for velocity in (-1.0, 0.25):
        effects = made([sized('target_motion', velocity=velocity)])
        center = np.mean(np.arange(2048)[BOTH_ON]) / RATE + m.start_delay[0] / 2
        expected = velocity * (CENTER / CHIRP + center)
        assert CENTER / CHIRP == pytest.approx(38.67e-3, abs=5e-6)
        assert combined(m, effects) == pytest.approx(expected, abs=3e-6)
        assert path_delay(m, effects) == pytest.approx(0.0, abs=1e-20)


def test_motion_of_each_distance():
    """One velocity for each of a standing crane's distances; too few are refused."""
    entry = sized('target_motion', velocity=[0.5, -0.2])
    trajectory = {'standing': {'distances': [50, 100, 150], 'sweeps': 2}}
    timeline = Timeline(scene(trajectory))
    m = timeline.measurements(timeline.slots(4), 0)
    assert prepared(m, made([entry])).velocity == pytest.approx([0.5, 0.5, -0.2, -0.2])
    with pytest.raises(ConfigurationError, match='too few'):
        prepared(timeline.measurements(timeline.slots(6), 0), made([entry]))
    with pytest.raises(ConfigurationError, match='empty'):
        made([sized('target_motion') | {'velocity': []}])


def test_sway_is_a_sine_in_time():
    """Place, velocity and acceleration at each sweep are those of the sine; within it too, to the third order."""
    m = measured(5, speed=2.0)
    for phase in (0.0, 1.0):
        effects = made([sized('sway', amplitude=0.02, frequency=3.0, phase=phase)])
        path, direct = prepared(m, effects).paths[0], m.paths[0]
        for t in (0.0, 0.5e-3, 1e-3):
            added = path.delay - direct.delay + (path.rate - direct.rate) * t
            added = added + (path.acceleration - direct.acceleration) * t * t / 2
            place = 0.02 * np.sin(2 * np.pi * 3.0 * (m.time + t) + phase)
            assert added * C / m.refractive_index == pytest.approx(
                place, abs=0.02 * (2 * np.pi * 3.0 * t) ** 3 / 6 + 1e-12
            )


def test_slant_is_longer_than_its_horizontal():
    """sqrt(R^2 + h^2) of air, at any sign of h; spread over the longer way the power is less."""
    for distance in (0.0, 20.0, 200.0):
        m = measured(1, distance)
        for height in (7.0, -7.0):
            effects = made([sized('slant_geometry', height_difference=height)])
            slant = math.hypot(distance, height)
            assert path_delay(m, effects) == pytest.approx((slant - distance) * m.refractive_index / C, rel=1e-9)
            if distance:
                loss = m.stations[0].received_power - prepared(m, effects).stations[0].received_power
                assert loss == pytest.approx(20.0 * math.log10(slant / distance))
    driving = measured(1, 30.0, speed=2.0, start=80)
    effects = made([sized('slant_geometry', height_difference=20.0)])
    cosine = driving.range / np.hypot(driving.range, 20.0)
    assert prepared(driving, effects).paths[0].rate == pytest.approx(driving.paths[0].rate * cosine)


# --- clocks and noise ---


def test_reference_drifts_and_warms_up():
    """ppm per hour from the start on; a warm-up falls to 1/e of itself in its time constant; the ADC goes along."""
    m = measured(13)  # 0, 50, ... 600 s
    before = m.stations[1].alpha
    steady = prepared(m, made([sized('reference_clock_drift', rate=-12.0)])).stations[1]
    assert steady.alpha - before == pytest.approx(-12e-6 * m.time / 3600.0, abs=1e-15)
    assert steady.sample_clock / m.stations[1].sample_clock == pytest.approx(steady.alpha / before, rel=1e-13)
    warming = prepared(m, made([sized('reference_clock_drift', warmup=2.0, time_constant=300.0)])).stations[1]
    assert (warming.alpha - before)[[0, 6, 12]] == pytest.approx([2e-6, 2e-6 / math.e, 2e-6 / math.e**2], rel=1e-9)


def test_phase_noise_takes_level_and_corner():
    """10 dB more of the same noise turns each sample's phase by sqrt(10) as much; left out, level and corner stay."""
    m = measured(3, waveform={'iq': True})
    for station in m.stations:
        station.noise_density[:] = -400.0
    errors = []
    for effects in ([], made([{'effect': 'phase_noise', 'level': -80.0}])):
        noisy = synthesise(m, SEED, effects, quantised=False)[0]
        clean = analogue(m)[0][:, BOTH_ON]
        errors.append(np.angle((noisy[..., 0] + 1j * noisy[..., 1])[:, BOTH_ON] * np.conj(clean)))
    assert np.allclose(errors[1], math.sqrt(10.0) * errors[0], atol=3e-6)
    changed = prepared(m, made([sized('phase_noise', corner=5e4)])).stations
    assert (changed[1].phase_noise.level, changed[1].phase_noise.corner) == (-90.0, 5e4)
    assert changed[0].phase_noise == m.stations[0].phase_noise
    for station in m.stations:
        station.phase_noise = None
    assert prepared(m, made([sized('phase_noise', level=-85.0, corner=1e5)])).stations[1].phase_noise.level == -85.0
    with pytest.raises(ConfigurationError, match='slave'):
        prepared(m, made([sized('phase_noise', level=-85.0)]))


def test_bursts_are_as_frequent_long_and_strong_as_declared():
    """1500 sweeps at probability 0.3: 1.2 % standard deviation, asserted to 6 % (5 sigma: false failure below 1e-6).

    Samples of noise in the bursts: 45000 and more, their power to 0.7 %, asserted to 4 %. Both stations' differ.
    """
    m = measured(1500)
    level, duration = -30.0, 5e-5
    effects = made([{'effect': 'interference_burst', 'probability': 0.3, 'level': level, 'duration': duration}])
    added = [b - a for a, b in zip(analogue(m), analogue(m, effects), strict=True)]
    for signal in added:
        hit = np.any(signal, axis=1)
        assert abs(np.mean(hit) - 0.3) < 0.06
        span = [np.ptp(np.flatnonzero(row)) + 1 for row in signal[hit]]
        assert max(span) <= math.ceil(duration * RATE) + 1
        assert np.median(span) == pytest.approx(duration * RATE, abs=1.0)
        power = np.sum(signal**2) / np.sum(span)
        assert power == pytest.approx((8192.0 * 10 ** (level / 20)) ** 2 / 2, rel=0.04)
    assert np.any(np.any(added[0], axis=1) != np.any(added[1], axis=1))


# --- reference ---


def references(effects, trajectory):
    """(time [s], reading [m], true distance [m]) of all reference readings of a short scenario."""
    scenario = scene(trajectory, effects=effects)
    timeline = Timeline(scenario)
    slots = timeline.slots(400)
    readings = [e.content.range for e in timeline.render(slots) if e.topic == '/reference/range']
    return slots.time, np.array(readings), slots.distance


def test_reference_shows_where_the_crane_was():
    """R(t - lag): v lag too little at even speed, nothing while it stands, also before the start."""
    drive = {'drive': {'waypoints': [50, 80], 'speed': 2.0, 'acceleration': 1.0, 'dwell': 1.0}}
    time, readings, distance = references([{'effect': 'reference_lag', 'lag': 0.3}], drive)
    even = (time > 3.3) & (time < 7.0)  # after a second's dwell and two seconds' speeding up
    assert even.sum() > 100
    assert distance[even] - readings[even] == pytest.approx(2.0 * 0.3)
    assert readings[time < 1.0] == pytest.approx(50.0)
    interpolated = np.interp(time[20:] - 0.3, time, distance)
    assert readings[20:] == pytest.approx(interpolated, abs=1e-4)  # acceleration x interval^2 / 8
    _, readings, distance = references(
        [{'effect': 'reference_lag', 'lag': 0.3}], {'standing': {'distances': [50, 80], 'sweeps': 20}}
    )
    assert np.array_equal(readings, distance)


def test_reference_is_offset_and_scaled():
    """Errors of the instrument: metres, parts of the distance, and both."""
    standing = {'standing': {'distances': [50, 1000], 'sweeps': 2}}
    offset, scale = {'effect': 'reference_offset', 'offset': -0.02}, {'effect': 'reference_scale', 'scale': 30.0}
    _, readings, distance = references([offset], standing)
    assert readings - distance == pytest.approx(-0.02)
    _, readings, distance = references([offset, scale], standing)
    assert readings - distance == pytest.approx(-0.02 + 30e-6 * distance)
