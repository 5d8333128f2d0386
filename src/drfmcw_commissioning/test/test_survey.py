"""The survey of a site: what it measures of made-up sweeps, and its verdict on simulated sites."""

import dataclasses
import json
import math
import re

import numpy as np
import pytest
import yaml
from checkout import CONFIG
from scenes import mapping, scene

from drfmcw_commissioning.survey.command import main
from drfmcw_commissioning.survey.evidence import PairEvidence, StationEvidence
from drfmcw_commissioning.survey.findings import DETECTION, find, worst
from drfmcw_commissioning.survey.requirements import Requirements, read_requirements
from drfmcw_commissioning.survey.verdict import Result, interval, judge, passes
from drfmcw_physics.settings import declared_parameters
from drfmcw_ros.calibration.document import Delay, Document, Temperatures
from drfmcw_sim.recording import write_recording

RATE = 50.0  # sweeps per second
SWEEPS = 5000


def evidence(**changes):
    """A crane that drives from 100 to 200 m in 100 s without any fault; `changes` replace columns."""
    rng = np.random.default_rng(5)
    count = np.arange(SWEEPS)
    distance = 100.0 + 100.0 * count / SWEEPS

    def station(name):
        excess = 0.2 * rng.normal(size=SWEEPS)
        return StationEvidence(
            name=name,
            power=-60.0 + excess,
            excess=excess,
            snr=np.full(SWEEPS, 45.0) + excess,
            noise=np.full(SWEEPS, -140.0),
            flags=np.zeros(SWEEPS, dtype=np.int64),
            temperatures=np.full(SWEEPS, 30.0),
            calibrated_at=25.0,
            calibrated_within=(math.nan, math.nan),
        )

    columns = {
        'pair': 'a/b',
        'stamps': (count / RATE * 1e9).astype(np.int64),
        'sweep_ids': count,
        'reference': distance,
        'reference_std': np.full(SWEEPS, 1e-3),
        'range': distance + 1e-3 * rng.normal(size=SWEEPS),
        'range_std': np.full(SWEEPS, 1e-3),
        'protection_level': np.full(SWEEPS, 9e-3),
        'flags': np.zeros(SWEEPS, dtype=np.int64),
        'clock_difference': 0.05 * rng.normal(size=SWEEPS),
        'stations': (station('a'), station('b')),
    }
    return PairEvidence(**{**columns, **changes})


def changed(pair, rows, **offsets):
    """The same with columns of both stations shifted in some rows."""
    stations = []
    for station in pair.stations:
        new = {}
        for name, value in offsets.items():
            new[name] = getattr(station, name).copy()
            new[name][rows] += value
        stations.append(dataclasses.replace(station, **new))
    return dataclasses.replace(pair, stations=tuple(stations))


def verdicts(pair, **requirements):
    asked = Requirements(**requirements)
    return {v.name: v for v in judge(find(pair, asked), asked)}


def test_faultless_travel_meets_every_requirement():
    found = verdicts(evidence())
    assert passes(list(found.values())), [v for v in found.values() if v.result is not Result.MET]
    assert set(found) <= set(declared_parameters(Requirements))


def test_numbers_of_a_faultless_travel_are_those_that_were_made():
    found = find(evidence(), Requirements())
    assert found.availability == 1.0 and found.sweeps == SWEEPS
    assert (found.lowest_rate, found.median_rate) == (RATE, RATE)
    assert found.longest_gap == pytest.approx(1.0 / RATE)
    assert found.accuracy == pytest.approx(2.97e-3, rel=0.1)  # 99.7 % of a normal distribution with 1 mm
    assert [board.distance for board in found.boards] == [5.0, 5.0]
    assert [b.begin for b in found.bins] == [100.0, 125.0, 150.0, 175.0]
    assert all(b.reasons == () for b in found.bins)
    assert found.bins[0].margin == pytest.approx(45.0 - DETECTION, abs=1.0)


def test_lost_sweeps_are_counted_whether_flagged_or_missing():
    kept = np.r_[0:1000, 1100:SWEEPS]  # 100 are not in the recording
    whole = evidence()
    columns = {
        f.name: getattr(whole, f.name)[kept]
        for f in dataclasses.fields(whole)
        if isinstance(getattr(whole, f.name), np.ndarray)
    }
    stations = tuple(
        dataclasses.replace(
            s,
            **{
                f.name: getattr(s, f.name)[kept]
                for f in dataclasses.fields(s)
                if isinstance(getattr(s, f.name), np.ndarray)
            },
        )
        for s in whole.stations
    )
    columns['flags'] = columns['flags'].copy()
    columns['flags'][2000:2050] = 32  # and 50 are refused
    found = find(dataclasses.replace(whole, **columns, stations=stations), Requirements())
    assert found.sweeps == SWEEPS and found.usable == SWEEPS - 150
    assert found.longest_gap == pytest.approx(101 / RATE)
    assert found.lowest_rate == 0.0 or found.lowest_rate < RATE
    short = verdicts(dataclasses.replace(whole, **columns, stations=stations))
    for name in ('availability', 'longest_gap'):
        assert short[name].result is Result.NOT_MET, name


def test_pause_of_the_measurement_is_no_gap():
    stamps = evidence().stamps.copy()
    stamps[2500:] += 60_000_000_000
    found = find(evidence(stamps=stamps), Requirements())
    assert found.longest_gap == pytest.approx(1.0 / RATE)
    assert found.lowest_rate == RATE


def test_where_the_link_suffers_is_named_with_its_cause():
    rows = slice(2600, 3700)  # 152 to 174 m
    shadow = find(changed(evidence(), rows, excess=-10.0, snr=-10.0), Requirements())
    (named,) = [b for b in shadow.bins if b.reasons]
    assert named.begin == 150.0 and re.search('shadowing.* 9 dB|shadowing.* 10 dB', named.reasons[0])
    assert worst(shadow, 1)[0][0].begin == 150.0
    wave = 4.0 * np.sin(np.arange(1100) / 15.0)
    fading = find(changed(evidence(), rows, excess=wave), Requirements())
    assert [b.begin for b in fading.bins if any('multipath' in r for r in b.reasons)] == [150.0]
    noisy = find(changed(evidence(), rows, noise=6.0), Requirements())
    assert [b.begin for b in noisy.bins if any('interference' in r for r in b.reasons)] == [150.0]
    bursts = find(changed(evidence(), rows, flags=32), Requirements())
    assert verdicts(changed(evidence(), rows, flags=32))['disturbed'].result is Result.NOT_MET
    assert [b.disturbed > 0.5 for b in bursts.bins] == [False, False, True, False]


def test_weak_antenna_of_one_station_is_no_shadowing():
    pair = evidence()
    lowered = changed(pair, slice(2600, 3700), excess=-10.0)
    found = find(dataclasses.replace(pair, stations=(pair.stations[0], lowered.stations[1])), Requirements())
    (named,) = [b for b in found.bins if b.reasons]
    assert "'b' receives" in named.reasons[0] and 'shadowing' not in named.reasons[0]


@pytest.mark.parametrize(
    ('changes', 'name'),
    [
        ({'range': evidence().reference + 0.03}, 'accuracy'),
        ({'range': evidence().reference + 0.012}, 'bias'),
        ({'range': evidence().reference + 0.013}, 'wrong'),
        ({'clock_difference': np.full(SWEEPS, -8.0)}, 'clock_difference'),
    ],
)
def test_each_requirement_can_fail(changes, name):
    assert verdicts(evidence(**changes))[name].result is Result.NOT_MET


@pytest.mark.parametrize(
    ('within', 'temperature', 'result'),
    [
        ((-10.0, 45.0), 45.0, Result.MET),
        ((-10.0, 45.0), 50.0, Result.NOT_MET),  # fusion flags every range, though the reference is but 25 K away
        ((-10.0, 45.0), -12.0, Result.NOT_MET),
        ((-40.0, 85.0), 80.0, Result.MET),  # 55 K from the reference, which the curve knows
        ((math.nan, math.nan), 64.0, Result.MET),
        ((math.nan, math.nan), 66.0, Result.NOT_MET),
        ((-10.0, 45.0), math.nan, Result.NOT_SHOWN),
    ],
)
def test_board_temperature_is_judged_by_the_range_of_the_calibration(within, temperature, result):
    """Of one station; the other one's calibration states no range and its board is 5 K from it."""
    pair = evidence()
    other = dataclasses.replace(pair.stations[1], calibrated_within=within, temperatures=np.full(SWEEPS, temperature))
    changed_pair = dataclasses.replace(pair, stations=(pair.stations[0], other))
    assert verdicts(changed_pair)['board_temperature'].result is result
    assert 'board_temperature' not in verdicts(changed_pair, board_temperature=math.nan)


def test_travel_that_was_not_driven_is_not_covered():
    assert verdicts(evidence(), travel_begin=50.0, travel_end=400.0)['coverage'].result is Result.NOT_MET
    assert verdicts(evidence(), travel_begin=100.0, travel_end=200.0)['coverage'].result is Result.MET


def test_without_a_reference_accuracy_is_not_shown_and_the_site_not_accepted():
    found = verdicts(evidence(reference=np.full(SWEEPS, math.nan)))
    for name in ('accuracy', 'bias', 'wrong'):
        assert found[name].result is Result.NOT_SHOWN
    assert not passes(list(found.values()))
    nothing = {'accuracy': math.nan, 'bias': math.nan, 'wrong': math.nan}
    assert passes(list(verdicts(evidence(reference=np.full(SWEEPS, math.nan)), **nothing).values()))


def test_interval_of_a_share_is_that_of_clopper_and_pearson():
    """Worked example: 0 of 10 gives 0 ... 0.3085 (rule of three, exact); and it is symmetric."""
    assert interval(0, 10) == pytest.approx((0.0, 0.3085), abs=1e-4)
    assert interval(10, 10) == pytest.approx((0.6915, 1.0), abs=1e-4)


def test_shipped_requirements_are_the_defaults():
    found = dataclasses.asdict(read_requirements(str(CONFIG / 'requirements.yaml')))
    assert {k: v for k, v in found.items() if v == v} == {
        k: v for k, v in dataclasses.asdict(Requirements()).items() if v == v
    }


# --- recordings ---

ASKED = {'bin_width': 5.0, 'rate': 10.0, 'availability': 0.99, 'fading_margin': 10.0, 'coverage': 0.9}
DRIVE = {'drive': {'waypoints': [60, 70], 'speed': 4.0, 'acceleration': 0.3}}


def recorded(directory, **sections):
    path = directory / 'recording'
    write_recording(scene(DRIVE, timing={'sweep_interval': 0.02}, **sections), path)
    return path


def run(directory, recording, **changes):
    file = directory / 'requirements.yaml'
    file.write_text(yaml.safe_dump(ASKED | changes))
    page, data = directory / 'report.html', directory / 'report.json'
    arguments = ['--requirements', str(file), '--out', str(page), '--json', str(data), '--estimator', 'hann']
    status = main([str(recording), *arguments])
    return status, page, data


def test_good_site_is_accepted(tmp_path, capsys):
    status, page, data = run(tmp_path, recorded(tmp_path))
    assert status == 0, capsys.readouterr().out
    found = json.loads(data.read_text())
    assert found['verdict'] == 'pass' and {v['result'] for v in found['verdicts']} == {'met'}
    assert re.fullmatch('[0-9a-f]{64}', found['sha256'])
    text = page.read_text()
    assert 'meets all' in text and 'signature' in text
    assert not re.search(r'(src|href)="(?!data:)', text), 'the page needs nothing else'


def test_board_warmer_than_its_calibration_is_refused(tmp_path):
    """A calibration to 45 degC, a board at 50 degC, from a recording."""
    stored = Document('master', temperature=Temperatures(25.0, -10.0, 45.0), delay=Delay(12e-9))
    (tmp_path / 'stored.yaml').write_text(stored.text())
    stations = mapping(DRIVE)['stations']
    stations['master'] |= {'board_temperature': 50.0, 'calibration': str(tmp_path / 'stored.yaml')}
    status, _, data = run(tmp_path, recorded(tmp_path, stations=stations))
    found = {v['name']: v for v in json.loads(data.read_text())['verdicts']}['board_temperature']
    assert status == 1 and found['result'] == 'not met'
    assert found['measured'] == '5.0 K beyond' and "'master'" in found['note']
    assert found['required'] == 'within the calibration, -10 to 45 degC'


def test_disturbed_site_with_a_strayed_clock_is_refused_with_the_reasons(tmp_path, capsys):
    effects = [
        {'effect': 'reference_clock_offset', 'station': 'slave', 'deviation': 8.0},
        {'effect': 'interference_burst', 'station': 'master', 'probability': 0.2, 'level': -20.0, 'duration': 3e-5},
    ]
    status, page, data = run(tmp_path, recorded(tmp_path, effects=effects))
    assert status == 1
    found = {v['name']: v for v in json.loads(data.read_text())['verdicts']}
    assert found['clock_difference']['result'] == found['disturbed']['result'] == 'not met'
    assert abs(abs(float(found['clock_difference']['measured'].split()[0])) - 8.0) < 0.5
    assert 'not met' in page.read_text() and 'clock_difference' in capsys.readouterr().out


def test_wrong_key_is_named(tmp_path, capsys):
    status, page, _ = run(tmp_path, tmp_path / 'missing', acuracy=0.02)
    assert status == 2 and not page.exists()
    assert "'acuracy'" in (said := capsys.readouterr().err) and "'accuracy'" in said and said.count('\n') == 1


def test_missing_recording_is_named(tmp_path, capsys):
    status, page, _ = run(tmp_path, tmp_path / 'missing')
    assert status == 2 and not page.exists()
    assert 'missing' in (said := capsys.readouterr().err) and said.count('\n') == 1
