"""Calibrating on site: what ranges beside a reference correct, what they do not, and where that holds."""

import math

import numpy as np
import pytest
from checkout import ROOT

from drfmcw_commissioning.calibrate import main
from drfmcw_commissioning.site.candidates import Kind, candidates, response
from drfmcw_commissioning.site.command import calibrate_site
from drfmcw_commissioning.site.fit import fit_site
from drfmcw_commissioning.site.groups import Group
from drfmcw_commissioning.site.report import sentences
from drfmcw_fusion.offline import replay_recording
from drfmcw_fusion.replayed.statistics import setting_statistics
from drfmcw_fusion.settings import FusionSettings
from drfmcw_node.estimators.estimation import EstimatorSettings
from drfmcw_physics.oscillators import Calibration
from drfmcw_physics.sweep import Mode, SweepSettings
from drfmcw_ros.calibration.document import read_document
from drfmcw_sim.recording import write_recording
from drfmcw_sim.scenario import scenario_from_mapping

PRACTICE = next(
    (p for p in (ROOT / '../shared', ROOT / '../../shared') if p.exists()), ROOT / 'nowhere'
) / 'recordings/practice'  # fmt: skip
STATIONS = ('master', 'slave')
PAIR = Calibration('master', delay=12e-9), Calibration('slave', delay=15e-9)
DISTANCES = (40.0, 120.0, 300.0, 500.0, 700.0, 850.0, 1000.0)
AIR = 1.0  # standard deviation of the refractivity [1e-6]


def group(distance, error=0.0, excess=0.0, boards=(25.0, 25.0), std=1e-3):
    mode, late = (Mode.LONG_DISTANCE, 0.6e-6) if distance > 650.0 else (Mode.SHORT_DISTANCE, 3.41e-6)
    sweeps = tuple(
        SweepSettings(*names, role=role, mode=mode, start_delay=late)
        for role, names in ((1, STATIONS), (2, STATIONS[::-1]))
    )
    return Group(distance, error, std, excess, 0.4e-9, boards, 1.0003, sweeps, 24, 0)


def groups_with(amounts, distances=DISTANCES, boards=None, seed=1):
    """Groups displaced by candidates (kind, station): units, and by noise of 1 mm and 0.4 ns."""
    random = np.random.default_rng(seed)
    boards = boards or [tuple(25.0 + 15.0 * random.standard_normal(2)) for _ in distances]
    plain = [group(d, boards=b) for d, b in zip(distances, boards, strict=True)]
    error, excess = 1e-3 * random.standard_normal(len(plain)), 0.4e-9 * random.standard_normal(len(plain))
    for candidate in candidates(PAIR, plain, AIR):
        error_per, excess_per = response(candidate, plain, PAIR)
        amount = amounts.get((candidate.kind, candidate.station), 0.0)
        error, excess = error + amount * error_per, excess + amount * excess_per
    return [group(d, float(e), float(x), b) for d, e, x, b in zip(distances, error, excess, boards, strict=True)]


def fitted(groups, pair=PAIR, air_std=AIR):
    return fit_site(groups, pair, candidates(pair, groups, air_std))


def found(fit):
    return {(c.candidate.kind, c.candidate.station): (c.value, c.std) for c in fit.corrections}


@pytest.mark.parametrize(
    'amounts',
    [
        {},
        {(Kind.DELAY, 1): 0.5},
        {(Kind.CLOCK, 0): -8.0},
        {(Kind.DELAY, 1): -0.3, (Kind.CLOCK, 1): 5.0},
        {(Kind.DELAY_SLOPE, 0): 6.0},
        {(Kind.CLOCK_SLOPE, 1): 0.4, (Kind.DELAY, 1): 0.2},
        {(Kind.SAMPLE_CLOCK, 0): 20.0},
    ],
)
def test_what_was_changed_is_what_is_corrected(amounts):
    """Seven distances, boards at temperatures of their own: each correction within 5 of its standard deviations."""
    fit = fitted(groups_with(amounts))
    assert found(fit).keys() == amounts.keys()
    for key, (value, std) in found(fit).items():
        assert value == pytest.approx(amounts[key], abs=5.0 * std)
    assert np.all(np.abs(fit.residual) < 5.0 * fit.residual_std) and fit.explained.all()


def test_standard_deviations_of_corrections_hold():
    """30 sites: mean square of error over standard deviation, 1 +- 0.26 by chance; 3 sigma: 0.3 %."""
    amounts = {(Kind.DELAY, 1): 0.5, (Kind.CLOCK, 0): -8.0}
    pulls = []
    for seed in range(30):
        corrections = found(fitted(groups_with(amounts, seed=seed + 10)))
        pulls.append([(corrections[key][0] - amounts[key]) / corrections[key][1] for key in amounts])
    squares = np.mean(np.square(pulls), axis=0)
    assert squares[0] == pytest.approx(1.0, abs=0.8)
    assert squares[1] < 1.0, 'T_off is trusted to 10 ns only, but exact here'


def test_one_distance_gives_an_offset_and_says_what_it_cannot_separate():
    boards = [(25.0, 25.0)] * 4
    fit = fitted(groups_with({(Kind.DELAY, 1): 0.05}, distances=(100.0,) * 4, boards=boards))
    (correction,) = fit.corrections
    assert (correction.candidate.kind, correction.candidate.station) == (Kind.DELAY, 1)
    assert {c.kind for c in correction.rivals} >= {Kind.SAMPLE_CLOCK}
    said = ' '.join(sentences(fit, STATIONS))
    assert 'cannot separate it from the ADC clock beside the reference' in said
    assert 'a frequency counter on the ADC clocks' in said


def test_a_common_scale_of_both_clocks_is_not_pretended_to_be_one_clock():
    """With clocks stated to 0.02 ppm, 8 ppm of scale can only be the air, which no station holds."""
    stds = {'alpha_std': 2e-8, 'sample_clock_alpha_std': 2e-8, 'delay_std': 2e-11}
    stated = tuple(Calibration(c.station, delay=c.delay, **stds) for c in PAIR)
    fit = fitted(groups_with({(Kind.AIR, -1): 8.0}), stated, air_std=10.0)
    assert found(fit).keys() == {(Kind.AIR, -1)}


def test_a_distance_that_no_calibration_explains_is_left_out_and_named():
    groups = groups_with({(Kind.DELAY, 1): 0.5})
    bent = groups[2]
    groups[2] = group(bent.distance, bent.error + 0.05, bent.excess, bent.board)
    fit = fitted(groups)
    assert list(fit.explained) == [i != 2 for i in range(len(groups))]
    assert found(fit)[Kind.DELAY, 1][0] == pytest.approx(0.5, abs=0.03)
    assert any('Left out: 300.0 m' in line and 'diagnose' in line for line in sentences(fit, STATIONS))


def test_what_cannot_be_seen_here_is_named_with_the_measurement_that_would_show_it():
    """At 100 m alone a clock's scale is hidden behind T_off's tolerance: it could displace ranges, and is named."""
    boards = [(25.0 + i, 25.0 + i) for i in range(4)]
    fit = fitted(groups_with({}, distances=(100.0,) * 4, boards=boards))
    assert not fit.corrections
    said = sentences(fit, STATIONS)
    assert said[0].startswith('No correction')
    assert all('It would take' in line for line in said[1:])


def site(tmp_path, **slave):
    """A recording whose slave is not as it states; returns its path."""
    scene = scenario_from_mapping(
        {
            'stations': {'master': {'delay': 12e-9}, 'slave': {'delay': 15e-9}},
            'pairs': [
                {'first': 'master', 'second': 'slave', 'standing': {'distances': [40, 200, 500, 900], 'sweeps': 16}}
            ],
            'reference': {'range_std': 0.002},
            'effects': [{'effect': 'delay_offset', 'delay': 0.4}],
            'seed': 8,
        },
        'test',
    )
    path = tmp_path / 'site'
    write_recording(scene, path)
    return str(path)


def test_result_is_a_document_that_replay_loads(tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    path = site(tmp_path)
    assert main(['site', path, '--operator', 'C', '--store', '--state', 'state']) == 0
    said = capsys.readouterr().out
    assert "hardware delay of 'slave': +0." in said and '--calibration ./master.calibration.yaml' in said
    documents = [read_document(f'{name}.calibration.yaml') for name in STATIONS]
    assert documents[1].delay.value == pytest.approx(15.4e-9, abs=0.03e-9)
    assert (documents[1].delay.peer, documents[1].operator, documents[1].version) == ('master', 'C', 1)
    before = replay_recording(path, EstimatorSettings(estimator='ml'))
    after = replay_recording(path, EstimatorSettings(estimator='ml'), calibrations=[d.calibration() for d in documents])
    bias = [np.mean([row.bias for row in setting_statistics(r.results, r.reference)]) for r in (before, after)]
    assert bias[0] == pytest.approx(0.12, abs=5e-3) and abs(bias[1]) < 2e-3


def test_marks_take_the_place_of_a_reference(tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    path = site(tmp_path)
    (tmp_path / 'marks.csv').write_text('range,std\n40,0.003\n200,0.003\n500,0.003\n900,0.003\n')
    assert main(['site', path, '--marks', 'marks.csv']) == 0
    assert "hardware delay of 'slave': +0." in capsys.readouterr().out
    (tmp_path / 'marks.csv').write_text('range,std\n40,near\n')
    assert main(['site', path, '--marks', 'marks.csv']) == 2
    assert capsys.readouterr().err == (
        "drfmcw calibrate: marks.csv: mark 1: expected numbers in columns 'range' and 'std'\n"
    )
    (tmp_path / 'marks.csv').write_text('range,std\n300,0.1\n')
    assert main(['site', path, '--marks', 'marks.csv']) == 2
    assert 'no group of five usable ranges' in capsys.readouterr().err


@pytest.mark.skipif(not PRACTICE.exists(), reason='lies in shared/recordings only')
@pytest.mark.parametrize(
    ('number', 'kind', 'station', 'truth'),
    [(1, Kind.CLOCK, 1, 12.0), (3, Kind.CLOCK_SLOPE, 0, -0.35), (7, Kind.DELAY_SLOPE, 0, 6.0)],
)
def test_practice_recordings_are_without_bias_afterwards(number, kind, station, truth):
    """By another hand: the concealed error is the one corrected, and no bias stays beyond 1 mm + 3 sigma / sqrt(n)."""
    path = str(PRACTICE / f'recording_{number}')
    fit, documents, _, _ = calibrate_site(path)
    ((key, (value, std)),) = found(fit).items()
    assert key == (kind, station) and value == pytest.approx(truth, abs=4.0 * std)
    replay = replay_recording(
        path,
        EstimatorSettings(estimator='ml'),
        FusionSettings(velocity='standing'),
        calibrations=[document.calibration() for document in documents],
    )
    determined = {round(g.distance) for g, good in zip(fit.groups, fit.explained, strict=True) if good}
    rows = [r for r in setting_statistics(replay.results, replay.reference) if round(r.reference) in determined]
    assert len(rows) >= 12
    for row in rows:
        assert abs(row.bias) < 1e-3 + 3.0 * row.std / math.sqrt(row.n), row.reference
