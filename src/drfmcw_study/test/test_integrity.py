"""A wrong range is never published as valid: each fault that the data show is doubted or refused."""

import dataclasses
import itertools
import math

import numpy as np
import pytest
from scenes import record, scene

from drfmcw_fusion.combination import PathDelay, Station
from drfmcw_fusion.integrity import continuity
from drfmcw_fusion.integrity.checks import Decision, Test
from drfmcw_fusion.integrity.continuity import Limits, Measured
from drfmcw_fusion.integrity.monitor import PairMonitor
from drfmcw_fusion.integrity.settings import IntegritySettings
from drfmcw_fusion.offline import replay_recording
from drfmcw_fusion.pipeline import Flag
from drfmcw_node.estimators.damage import has_burst
from drfmcw_node.estimators.estimation import EstimatorSettings
from drfmcw_node.estimators.registry import estimator
from drfmcw_node.processing.processor import shares_noise
from drfmcw_node.processing.records import Beat
from drfmcw_physics.oscillators import Calibration
from drfmcw_physics.sweep import SweepSettings
from drfmcw_study.campaign.faults import faults
from drfmcw_study.campaign.measuring import Case, measure
from drfmcw_study.campaign.report import bound

Test.__test__ = False  # a name of the monitor's, no test class
START = 1_700_000_000_000_000_000
REFUSED = Flag.MODEL_MISMATCH | Flag.SIGNAL_QUALITY

FAULTS = [fault for fault in faults() if fault.name != 'none']


@pytest.mark.parametrize('fault', FAULTS, ids=lambda f: f'{f.name}, {f.size}'.replace(' ', '_'))
def test_fault_makes_no_wrong_range_valid(fault):
    """Sixty clean sweeps, then forty with the fault: no valid range is off by more than five standard deviations.

    Seeded. A valid range of a harmless fault is off by so much in 6e-7 of all sweeps.
    """
    found = measure(Case(fault, 300.0, 'ml', 0.0, 40, 3))
    assert found.wrong == 0
    assert found.beyond == 0


@pytest.mark.parametrize('speed', [0.0, 1.5])
@pytest.mark.parametrize('name', ['ml', 'hann'])
def test_clean_sweeps_stay_valid(speed, name):
    """Refusals of 1e-4 a sweep at most: none among 200 but for a probability of 2 %; the seed is fixed."""
    found = measure(Case(faults()[0], 300.0, name, speed, 200, 5))
    assert (found.valid, found.wrong, found.beyond) == (200, 0, 0)


@pytest.mark.parametrize('name', ['paper', 'hann', 'ml'])
def test_noise_alone_is_no_line(name):
    """4000 sweeps of noise: at 1e-6 each one is accepted with a probability of 0.4 %; 13 dB alone lets some pass."""
    calibration = Calibration('master', noise_floor=-140.7, phase_noise_level=-90.0, phase_noise_corner=200e3)
    chosen = estimator(SweepSettings('master', 'slave'), EstimatorSettings(estimator=name), False, *[calibration] * 2)
    noise = np.rint(np.random.default_rng(4).normal(0.0, 21.6, (4000, 2048))).astype(np.int16)
    assert (chosen(noise, 32767.0).flags & 1).all()


@pytest.mark.parametrize('share', [1.0, 0.1])
def test_buffer_that_is_read_twice_is_found_by_its_noise(share):
    """The line's phase goes on, but 64 samples of noise stand in two sweeps: the second one is dropped."""
    generator = np.random.default_rng(12)
    first, second = (np.rint(generator.normal(0.0, 3.0, 2048)).astype(np.int16) for _ in range(2))
    assert not shares_noise(first, second)
    again = second.copy()
    again[900 : 900 + round(2048 * share)] = first[900 : 900 + round(2048 * share)]
    assert shares_noise(first, again)


def test_noise_of_different_sweeps_is_never_shared():
    """20 000 pairs with noise of half a code and no line at all, the worst case; zeros and clipping are no noise."""
    noise = np.rint(np.random.default_rng(13).normal(0.0, 0.5, (20_000, 2048))).astype(np.int16)
    assert not any(shares_noise(a, b) for a, b in itertools.pairwise(noise))
    clipped = np.where(np.sin(np.arange(2048)) > 0.0, 32767, -32768).astype(np.int16)
    for row in (np.zeros(2048, np.int16), np.full(2048, 77, np.int16), clipped):
        assert not shares_noise(row, row)


def test_burst_is_seen_and_a_line_is_none():
    t = np.arange(2048)
    lines = 1000.0 * np.cos(2 * np.pi * np.array([[0.006], [0.1], [0.33], [0.49]]) * t)
    lines += np.random.default_rng(5).normal(0.0, 200.0, lines.shape)
    assert not has_burst(lines, True).any()
    lines[:, 900:940] *= 5.0
    assert has_burst(lines, True).all()


def measured(number, distance, interval=0.02, std=1e-3, phase=None):
    """One sweep of a crane at `distance`; the carrier phase repeats every 25.84 mm."""
    half_wave = 299792458.0 / 5.8e9 / 2.0
    phase = 2.0 * math.pi * distance / half_wave if phase is None else phase
    path = PathDelay(0.0, 0.0, std / 3e8, math.remainder(phase, 2.0 * math.pi), 5e-4, 5.8e9, 5.8e9)
    return Measured(START + round(number * interval * 1e9), path, distance, std, 1.0, 0.0387, (0, 3.41e-6))


def judged(ranges, **kwargs):
    monitor = PairMonitor(Limits(10.0, 0.3), IntegritySettings())
    return [monitor.follow(measured(i, r, **kwargs)).verdict.decision for i, r in enumerate(ranges)]


def test_longer_range_never_replaces_a_shorter_one():
    """The direct path is blocked, an echo 10 m longer takes its place: refused for as long as sweeps go on."""
    decisions = judged([100.0] * 50 + [110.0] * 1000)
    assert decisions[:50] == [Decision.VALID] * 50
    assert set(decisions[50:]) == {Decision.REFUSED}


def test_direct_path_that_comes_back_is_valid_soon():
    """Eight sweeps show that it is no chance."""
    decisions = judged([100.0] * 50 + [110.0] * 200 + [100.0] * 10)
    assert decisions[258:] == [Decision.VALID] * 2


def test_one_outlier_costs_one_range():
    decisions = judged([100.0] * 50 + [100.1] + [100.0] * 10)
    assert decisions == [Decision.VALID] * 50 + [Decision.REFUSED] + [Decision.VALID] * 10


@pytest.mark.parametrize(('moved', 'after'), [(0.017, Decision.REFUSED), (0.0, Decision.VALID)])
def test_break_of_the_phases_is_followed_by_what_the_mean_shows(moved, after):
    """The carrier phase jumps once, by 40 degrees. Ranges that moved by less than their gate with it stay refused.

    Seeded: 16 ranges of 4 mm show 17 mm at 16 standard deviations, and 0 beyond 4.5 in 7e-6 of all cases.
    """
    rng = np.random.default_rng(8)
    turn = 4 * math.pi * 5.8e9 / 299792458.0
    monitor = PairMonitor(Limits(10.0, 0.3), IntegritySettings())
    found = []
    for i in range(200):
        jumped = i >= 100
        distance = 100.0 + rng.normal(0.0, 4e-3) + moved * jumped
        found.append(monitor.follow(measured(i, distance, std=4e-3, phase=turn * 100.0 + 0.7 * jumped)))
    decisions = [judgement.verdict.decision for judgement in found]
    assert set(decisions[:100]) == {Decision.VALID}
    assert set(decisions[100:115]) == {Decision.REFUSED}
    assert set(decisions[120:]) == {after}


def test_steady_shorter_range_replaces_a_longer_one():
    """An echo was tracked, then the direct path is free: after two seconds it is followed, not before."""
    decisions = judged([110.0] * 50 + [100.0] * 200)
    assert set(decisions[50:150]) == {Decision.REFUSED}
    assert decisions[-20:] == [Decision.VALID] * 20


def shifted(by, before, during, after=0):
    """Verdicts of a range that moves by `by` [m] and later comes back; 1 m of resolution, noise of 1 mm."""
    rng = np.random.default_rng(9)
    monitor = PairMonitor(Limits(10.0, 0.3), IntegritySettings())
    found = []
    for i in range(before + during + after):
        distance = 100.0 + by * (before <= i < before + during) + rng.normal(0.0, 1e-3)
        sweep = dataclasses.replace(
            measured(i, distance, phase=4 * math.pi * 5.8e9 / 299792458.0 * 100.0), resolution=1.0
        )
        found.append(monitor.follow(sweep).verdict)
    return found


def test_longer_range_is_followed_in_doubt_after_long():
    """10 m longer: refused for 30 s, then published with 10 m of standard deviation; 2 s after its end all is well."""
    found = shifted(10.0, 100, 2000, 300)
    assert {v.decision for v in found[100:1590]} == {Decision.REFUSED}
    assert {v.decision for v in found[1620:2100]} == {Decision.DOUBTFUL}
    assert all(v.std >= 9.9 for v in found[1620:2100])
    assert {v.decision for v in found[2100:2199]} == {Decision.REFUSED}
    assert {v.decision for v in found[2250:]} == {Decision.VALID}


@pytest.mark.parametrize('by', [0.3, -0.3])
def test_shift_within_the_resolution_is_followed_in_doubt(by):
    """Either track may be right: after 2 s the range comes back, with their difference in its standard deviation."""
    found = shifted(by, 100, 500)
    assert {v.decision for v in found[100:195]} == {Decision.REFUSED}
    assert {v.decision for v in found[250:]} == {Decision.DOUBTFUL}
    assert all(v.std >= 0.29 for v in found[250:])


def test_braking_is_no_scatter():
    """A crane that accelerates and brakes all the time, 8000 sweeps with 0.2 mm: none doubted, refused or wrong.

    Seeded. The velocity lags by 30 mm/s, so ranges by 1.15 mm; without an allowance for it 274 failed.
    """
    rng = np.random.default_rng(10)
    monitor = PairMonitor(Limits(10.0, 0.3), IntegritySettings())
    turn, rate = 4 * math.pi * 5.8e9 / 299792458.0, 0.0387
    velocity, distance, failed, wrong = 0.0, 200.0, 0, 0
    for i in range(8000):
        acceleration = (0.3, 0.0, -0.3, 0.0)[i // 60 % 4]
        noisy = distance + rate * velocity + rng.normal(0.0, 2e-4)
        sweep = measured(i, noisy, interval=0.15, std=2e-4, phase=turn * distance + rng.normal(0.0, 0.01))
        found = monitor.follow(sweep)
        failed += bool(found.verdict.failed)
        if found.motion.confirmed:
            error = abs(noisy - rate * found.motion.velocity - distance)
            wrong += error > 5.0 * math.hypot(2e-4, rate * found.motion.velocity_std, found.verdict.std)
        distance += velocity * 0.15 + 0.5 * acceleration * 0.15**2
        velocity += acceleration * 0.15
    assert (failed, wrong) == (0, 0)


def test_shift_below_the_resolution_stays_in_doubt():
    """A station's samples come early from a sweep on: 17 mm shorter, which no other path is; for 6 s."""
    early = next(f for f in faults() if (f.name, f.size) == ('samples shifted', '-8'))
    found = measure(Case(early, 300.0, 'ml', 0.0, 300, 3))
    assert found.valid > 150
    assert (found.wrong, found.beyond) == (0, 0)


def errors_in_std(times, distance, velocity, std, shift=lambda t: 0.0, turned=lambda t: 0.0, setting=lambda t: 0):
    """Errors over the standard deviations that are published, of ranges at `times` [s] that are not refused; decisions.

    Args:
        times: of sweeps [s].
        distance: function of time [m].
        velocity: function of time [m/s].
        std: of the noise [m].
        shift: of the range by a fault, function of time [m].
        turned: of the phase by a fault, function of time [rad].
        setting: mode, function of time.
    """
    rng = np.random.default_rng(11)
    monitor = PairMonitor(Limits(10.0, 0.3), IntegritySettings())
    rate, turn, found, decisions = 0.0387, 4 * math.pi * 5.8e9 / 299792458.0, [], []
    for t in times:
        phase = turn * distance(t) + turned(t) + rng.normal(0.0, 0.01)
        noisy = distance(t) + rate * velocity(t) + rng.normal(0.0, std) + shift(t)
        sweep = dataclasses.replace(
            measured(t, noisy, interval=1.0, std=std, phase=phase), resolution=1.0, setting=(setting(t), 3.41e-6)
        )
        judgement = monitor.follow(sweep)
        decisions.append(judgement.verdict.decision)
        if not judgement.motion.confirmed or judgement.verdict.decision == Decision.REFUSED:
            continue
        estimate = judgement.motion
        published = math.hypot(std, judgement.verdict.std, rate * estimate.velocity_std)
        found.append(abs(noisy - rate * estimate.velocity - distance(t)) / published)
    return found, decisions


def standing(_):
    return 0.0


def braking(t):
    """Distance and velocity of a crane that brakes from 1.2 m/s and drives on, by 0.3 m/s^2, every 16 s."""
    turns, t = divmod(t, 16.0)
    parts = ((4.0, 0.0), (4.0, -0.3), (4.0, 0.0), (4.0, 0.3))
    distance, velocity = 200.0 + turns * 9.6, 1.2
    for duration, acceleration in parts:
        step = min(max(t, 0.0), duration)
        distance += velocity * step + 0.5 * acceleration * step**2
        velocity += acceleration * step
        t -= duration
    return distance, velocity


@pytest.mark.parametrize('shift', [0.16, -0.16, 10.0])
def test_another_path_is_not_followed_when_its_phases_break(shift):
    """A range that jumps is refused; when its phase breaks 1.4 s later, it is no more right than before.

    Seeded, noise of 4 mm: a wrong range is off by 40 standard deviations and more.
    """
    found, _ = errors_in_std(
        np.arange(400) * 0.02,
        lambda t: 100.0,
        standing,
        4e-3,
        lambda t: shift * (t >= 2.0),
        lambda t: 1.5 * ((t >= 2.0) + (t >= 3.4)),
    )
    assert max(found) < 5.0


@pytest.mark.parametrize('rate', [5e-4, 2e-3, 5e-3, 2e-2])
def test_range_that_drifts_away_from_the_phases_is_doubted(rate):
    """The carrier phase shows that the crane stands while the range leaves by millimetres per second, as by an echo.

    Seeded, 1000 sweeps with noise of 1 mm; without the anchor up to 700 are off by up to 76 standard deviations.
    """
    found, decisions = errors_in_std(
        np.arange(1000) * 0.02, lambda t: 100.0, standing, 1e-3, lambda t: rate * max(t - 5.0, 0.0)
    )
    assert max(found) < 5.0
    assert set(decisions[:250]) == {Decision.VALID}
    assert decisions[-1] != Decision.VALID


@pytest.mark.parametrize('interval', [0.15, 0.2, 0.3, 0.5, 0.8])
def test_velocity_by_ranges_states_what_braking_does(interval):
    """Sweeps too rare for the phases: the parabola lags behind a changed acceleration; its standard deviation says so.

    Seeded; before it did, most ranges at 0.2 s were off by more than five standard deviations.
    """
    found, _ = errors_in_std(np.arange(400) * interval, lambda t: braking(t)[0], lambda t: braking(t)[1], 1e-3)
    assert len(found) > 380
    assert max(found) < 5.0


@pytest.mark.parametrize('gap', [0.3, 0.6, 0.9, 2.0, 4.5])
def test_gap_while_braking_makes_no_range_wrong_and_few_refused(gap):
    """Eight gaps: the velocity that changed meanwhile neither moves a range unseen nor ends the track.

    Seeded. Without it 450 to 1400 of 1600 sweeps were refused, and ranges after 2 s off by 8 to 23 standard deviations.
    """
    times = np.concatenate([np.arange(200) * 0.02 + k * (4.0 + gap) for k in range(8)])
    found, decisions = errors_in_std(times, lambda t: braking(t)[0], lambda t: braking(t)[1], 1e-3)
    assert max(found) < 5.0
    assert decisions.count(Decision.VALID) > 1500


@pytest.mark.parametrize(('differs', 'after'), [(0.0, Decision.VALID), (12e-3, Decision.DOUBTFUL)])
def test_both_modes_must_agree_on_one_distance(differs, after):
    """A crane stands while SD becomes LD: 12 mm between them, three standard deviations of one range, are doubted.

    Seeded: no single range shows it, but the filtered one leaves the mean of the mode before.
    """
    found, decisions = errors_in_std(
        np.arange(600) * 0.02,
        lambda t: 100.0,
        standing,
        4e-3,
        lambda t: differs * (t >= 6.0),
        lambda t: 0.9 * (t >= 6.0),
        lambda t: int(t >= 6.0),
    )
    assert set(decisions[:300]) == {Decision.VALID}
    assert after in decisions[400:]
    assert (Decision.DOUBTFUL in decisions[400:]) == (differs > 0.0)
    assert max(found) < 5.0


def test_ring_of_buffers_that_is_read_again_is_refused():
    """A dead driver's ring of 300 sweeps: each result stood there before, number and stamp are new."""
    monitor = PairMonitor(Limits(10.0, 0.3), IntegritySettings())
    sweep, path = SweepSettings('master', 'master'), PathDelay(0.0, 2e-7, 1e-12, math.nan, 5e-4, 5.8e9, math.nan)
    failed = []
    for i in range(600):
        beat = Beat('master', 'master', i, 0, 5e5 + i % 300, 1.0, 0.1, -60.0, 40.0, START + i)
        station = Station(beat, sweep, Calibration('master'))
        failed.append(monitor.judge_sweep(station, station, path, 30.0, False).failed)
    assert not any(f & Test.REPEATED for f in failed[:300])
    assert all(f & Test.REPEATED for f in failed[300:])


def test_pause_makes_any_distance_possible():
    monitor = PairMonitor(Limits(10.0, 0.3), IntegritySettings())
    for i in range(50):
        monitor.follow(measured(i, 100.0))
    assert monitor.follow(measured(5000, 400.0)).verdict.decision == Decision.VALID


def test_late_sweeps_are_put_in_order():
    """A link that reorders: every sweep gets the verdict and nearly the velocity of the ordered sequence."""
    rng = np.random.default_rng(6)
    number = np.arange(300)
    ranges = 100.0 + 1.5 * number * 0.02
    order = np.argsort(number + rng.uniform(0.0, 12.0, len(number)))
    monitor = PairMonitor(Limits(10.0, 0.3), IntegritySettings())
    found = {}
    for i in order.tolist():
        found[i] = monitor.follow(
            measured(i, ranges[i] + 0.0387 * 1.5, phase=4 * math.pi * 5.8e9 / 299792458.0 * ranges[i])
        )
    late = [found[i] for i in range(60, 300)]
    assert all(j.verdict.decision == Decision.VALID for j in late)
    assert all(abs(j.motion.velocity - 1.5) < 1e-3 for j in late if j.motion.confirmed)
    assert sum(j.motion.confirmed for j in late) > 0.95 * len(late)


def test_protection_level_is_infinite_where_refused():
    monitor = PairMonitor(Limits(10.0, 0.3), IntegritySettings())
    judgements = [monitor.follow(measured(i, 100.0 if i < 50 else 101.0)) for i in range(51)]
    assert judgements[49].protection_level(1e-3) < 0.015
    assert judgements[50].protection_level(1e-3) == math.inf
    assert judgements[50].verdict.failed == Test.CONTINUITY


def test_states_of_a_track_are_never_changed():
    """Going back to an earlier state is what puts late sweeps in order."""
    state, _ = continuity.begin(measured(0, 100.0), Limits(10.0, 0.3))
    before = dataclasses.astuple(dataclasses.replace(state.main, tracker=None))
    first = continuity.follow(state, measured(1, 100.0), Limits(10.0, 0.3), IntegritySettings())[1]
    assert dataclasses.astuple(dataclasses.replace(state.main, tracker=None)) == before
    assert continuity.follow(state, measured(1, 100.0), Limits(10.0, 0.3), IntegritySettings())[1] == first


def test_settings_without_monitor_leave_ranges_alone(tmp_path):
    path = str(record(scene({'standing': {'distances': [100.0], 'sweeps': 30}}), tmp_path / 'r'))
    results = replay_recording(path).results
    assert all(r.failed_tests == 0 for r in results)
    assert all(math.isfinite(r.protection_level) for r in results[8:])
    assert all(r.integrity_risk == 1e-5 for r in results)


def test_bound_of_a_rate():
    """No failure in n trials bounds the rate by about 3/n (the rule of three)."""
    assert bound(0, 1000) == pytest.approx(3.0 / 1000, rel=0.01)
    assert bound(5, 5) == 1.0
