"""Rehearsed commissionings: errors against what the calibrations state, and what the curves are for."""

import dataclasses
import re

import numpy as np
import pytest
from checkout import ROOT

from drfmcw_commissioning.calibrate import main
from drfmcw_commissioning.rehearsal.commissioning import TRUTH, Bench, Field, Outcome, calibrate, commission
from drfmcw_commissioning.rehearsal.contributing import contribution, parts, table
from drfmcw_commissioning.rehearsal.summary import summarise
from drfmcw_physics.constants import SPEED_OF_LIGHT

SHORT_BENCH = Bench(chambers=(-10.0, 18.0, 45.0), sweeps=4)


def test_a_few_commissionings_hold_what_they_state():
    """8 commissionings at two distances: chi-square of 8, above 4 times its mean in 1e-4 of cases (issue 15: 200)."""
    field = Field(distances=(150.0, 1000.0), sweeps=6)
    rows = summarise(commission(seed, SHORT_BENCH, field) for seed in range(8))
    for row in rows:
        assert 0.1 < row.chi_square < 4.0
        assert not row.systematic and row.flagged == 0
        assert 4e-3 < row.stated < 8e-3, 'the cable, mostly'


def test_calibration_on_the_bench_finds_the_stations():
    """Clocks and noise floors within 5 standard deviations; the sum of both delays within 5 of the cable's.

    Both oscillators' phase noise is half of the sum's, within 5 standard deviations and a bias of 0.3 dB.
    """
    documents = calibrate(np.random.default_rng(7), SHORT_BENCH)
    for name, truth in TRUTH.items():
        clock = documents[name].calibration()
        assert clock.alpha_at(25.0) == pytest.approx(truth.alpha, abs=5.0 * clock.alpha_std)
        assert clock.sample_clock_at(25.0) == pytest.approx(truth.sample_clock, abs=5.0 * clock.sample_clock_alpha_std)
        slope = documents[name].delay
        assert slope.slope == pytest.approx(truth.delay_slope, abs=5.0 * slope.slope_std + 1e-13)
        noise = documents[name].noise
        assert noise.floor == pytest.approx(truth.noise_floor, abs=5.0 * noise.floor_std) and noise.floor_std < 0.1
        half = np.log10(np.mean([10.0 ** (t.phase_noise_level / 10.0) for t in TRUTH.values()])) * 10.0
        assert noise.phase_level == pytest.approx(half, abs=5.0 * noise.phase_level_std + 0.3)
        assert noise.phase_level_std < 0.2
    total = sum(float(d.calibration().delay_at(25.0)) for d in documents.values())
    true = sum(t.delay for t in TRUTH.values())
    assert total == pytest.approx(true, abs=5.0 * 0.005 / SPEED_OF_LIGHT)
    assert {d.delay.peer for d in documents.values()} == set(TRUTH)


def test_without_the_curve_the_clocks_cost_what_equation_21_says():
    """Both boards at 40 degC, 1 km; the ADCs, which run from the references, take half of it back."""
    field = Field(distances=(1000.0,), coldest=40.0, warmest=40.0, sweeps=4)
    (outcome,) = commission(3, SHORT_BENCH, field)
    drift = {name: t.linear * 15.0 + t.cubic * 15.0**3 for name, t in TRUTH.items()}
    references = 1000.0 * sum(drift.values())  # eq. 21: range_bias of both references
    start_delay = 2.9e-6 * SPEED_OF_LIGHT
    lines = {'slave': (1000.0 + start_delay) / 2.0, 'master': (1000.0 - start_delay) / 2.0}
    adcs = sum(drift[name] * lines[name] for name in drift)
    expected = references - adcs
    assert outcome.without_curve - outcome.error == pytest.approx(expected, rel=0.2, abs=0.3e-3)
    assert abs(expected) > 2e-3


def test_contributions_add_up_and_stand_in_the_document():
    (delay,) = (p for p in parts() if p.name.startswith('hardware delay'))
    assert contribution(delay, 100.0) == pytest.approx(5e-3, rel=1e-3)
    (clock,) = (p for p in parts() if p.name.startswith('reference clocks, 0.02'))
    assert contribution(clock, 1000.0) == pytest.approx(1000.0 * 2e-8 * 2**0.5, rel=1e-3)
    assert table((100.0, 1000.0)).count('\n') == len(parts()) + 1


def test_contribution_of_noise_is_the_bound_that_estimators_are_held_against():
    """The study computes it from simulated sweeps' amplitudes: docs/estimators.md, to its rounding."""
    document = (ROOT / 'docs/estimators.md').read_text(encoding='utf-8')
    ((_, at_500, at_1000),) = re.findall(r'bound, floor A / B \[mm\] \|(.*) \| (.*) \| (.*) \|', document)
    noises = [part for part in parts() if part.name.startswith('noise of one sweep')]
    for distance, bounds in ((500.0, at_500), (1000.0, at_1000)):
        for part, bound in zip(noises, bounds.split(' / '), strict=True):
            assert contribution(part, distance) == pytest.approx(1e-3 * float(bound), rel=2e-3)


def test_summary_counts_what_is_outside():
    outcome = Outcome(100.0, 0.01, 0.005, 0.005, 0, 0.01)
    good, bad = outcome, dataclasses.replace(outcome, error=0.02, flags=4)
    (row,) = summarise([[good], [bad]])
    assert (row.count, row.within, row.flagged) == (2, 0.5, 1)
    assert row.chi_square == pytest.approx((4.0 + 16.0) / 2)
    slight = dataclasses.replace(good, error=2e-3)
    assert summarise([[bad]] * 20)[0].systematic and not summarise([[slight]])[0].systematic
    assert summarise([[slight]])[0].holds, 'one commissioning does not show that chi-square is not 1'


@pytest.mark.parametrize(('scale', 'holds'), [(0.8, False), (0.95, True), (1.05, True), (1.2, False)])
def test_errors_must_be_as_large_as_stated(scale, holds):
    """400 normal errors (seed 8) of `scale` times what is stated: chi-square is scale squared +- 7 %."""
    errors = np.random.default_rng(8).normal(0.0, scale * 5e-3, 400)
    (row,) = summarise([[Outcome(100.0, float(error), 5e-3, 5e-3, 0, 0.0)] for error in errors])
    assert row.holds == holds and not row.systematic


def test_rehearsal_is_a_command(capsys, tmp_path):
    assert main(['rehearse', '--times', '1']) == 2
    assert '--times must be 2' in capsys.readouterr().err
    assert main(['contributions', '--distance', '250']) == 0
    assert 'at 250 m [mm]' in capsys.readouterr().out
    for wrong in ('-5', 'nan', '0', '2e4'):
        assert main(['contributions', '--distance', wrong]) == 2
        assert '--distance' in capsys.readouterr().err


def test_table_of_contributions_in_the_document_is_that_of_the_command():
    document = (ROOT / 'docs/sensors_and_flags.md').read_text(encoding='utf-8')
    assert table((100.0, 1000.0)) in document, 'run ./drfmcw calibrate contributions'
