"""The paper's figures and claims: what follows from its equations exactly, and simulation against prediction."""

import math

import pytest
from checkout import ROOT
from scipy.stats import chi2

from drfmcw_node.estimators.estimation import EstimatorSettings
from drfmcw_physics.sweep import Mode
from drfmcw_study import reproduce
from drfmcw_study.paper import claims
from drfmcw_study.paper.catalogue import SECTIONS
from drfmcw_study.paper.experiments import NOISE_FLOORS, Point, Run, predict, simulate_all, site

DOCUMENT = ROOT / 'docs' / 'reproduction.md'
IDEAL = {'alphas': (1.0, 1.0), 'station': {'adc_bits': 16}}  # the table knows no quantisation noise


def crane(distance, floor='B', **options):
    mode = Mode.LONG_DISTANCE if distance > 650 else Mode.SHORT_DISTANCE
    return Point(f'test {distance} {floor}', site('gantry', distance, floor=floor, **options), mode)


def test_contradictions_of_the_paper_are_those_that_are_known():
    """Every row of the reference's list differs; what it says about each is found by our code."""
    found = {claim.where: claim for claim in claims.contradictions()}
    assert not any(claim.agrees for claim in found.values())
    assert '60 mm' in found['eq. 23'].ours
    assert '299711916 m/s, 24.9 mm' in found['V-B-4'].ours and '19 %' in found['V-B-4'].why
    assert '40.0 mm' in found['V-B-2'].ours and '80.0 mm' in found['V-B-2'].ours and '40.0 mm' in found['V-B-2'].why
    assert '1023.0 m' in found['V-C'].ours and '847 m' in found['V-C'].ours
    assert '2046 m' in found['V-C, VI'].ours and '2503 kHz' in found['V-C, VI'].ours
    assert '-21 ... +225 mm' in found['V-B-4, Fig. 10'].ours
    assert '-37.2 dBm' in found['V-B'].ours and '20.6 m' in found['V-B'].ours
    assert '+40.0 mm by eq. 20, -40.0 mm by eq. 21' in found['eqs. 20, 21'].ours
    assert '38.67 mm per m/s' in found['left out'].ours and '0.52 m/s' in found['left out'].ours
    assert sum(claim.known for claim in found.values()) == 8


def test_what_follows_from_table_1_agrees_with_the_paper():
    assert all(claim.agrees for claim in claims.agreements())


def test_fig_10_of_the_paper_needs_the_misprint_and_the_drift_of_fig_9():
    """+-28 mm: with the misprinted wet term and an oscillator drift that fills the +-20 mm of Fig. 9, not otherwise."""
    slope = claims.slope_of_paper()
    assert claims.drift_bias(-20.0, slope) == pytest.approx(-0.020, rel=1e-4)
    printed = 'paper_eq23_as_printed'
    assert max(map(abs, claims.weather_bounds(printed, slope))) < 0.028
    for other in (
        claims.weather_bounds(printed),
        claims.weather_bounds(printed, slope, claims.PRINTED_VELOCITY),
        claims.weather_bounds('paper_eq23_corrected', slope),
        claims.weather_bounds('itu_r_p453', slope),
    ):
        assert max(map(abs, other)) > 0.028


# mm, from the reference table: Hann A / B, maximum-likelihood bound A / B, synchronised single station A
@pytest.mark.parametrize(
    ('distance', 'hann', 'bound', 'synchronised'),
    [
        (15, (0.26, 0.31), (0.170, 0.206), 2.69),
        (200, (0.46, 2.40), (0.300, 1.57), 2.74),
        (1000, (1.69, 11.92), (1.11, 7.80), 3.57),
    ],
)
def test_predicted_standard_deviations_are_those_of_the_reference_table(distance, hann, bound, synchronised):
    for floor, windowed, smallest in zip(NOISE_FLOORS, hann, bound, strict=True):
        found = predict(crane(distance, floor, **IDEAL))
        assert found.windowed * 1e3 == pytest.approx(windowed, rel=0.06)
        assert found.bound * 1e3 == pytest.approx(smallest, rel=0.06)
    assert predict(crane(distance, 'A', **IDEAL)).synchronised * 1e3 == pytest.approx(synchronised, rel=0.03)


def test_simulated_standard_deviation_of_fig_11_is_the_predicted_one():
    """Chance of a false failure, were the prediction 4 % off: 1e-6 for all six values."""
    points = [crane(d) for d in (50.0, 500.0, 1000.0)]
    run = Run(trials=600, seed=5, estimator=EstimatorSettings())
    low, high = (chi2.ppf(p, run.trials - 1) / (run.trials - 1) for p in (1e-7, 1 - 1e-7))
    for point, outcome in zip(points, simulate_all(points, run, jobs=1), strict=True):
        expected = predict(point)
        pairs = ((outcome.std, expected.windowed), (outcome.synchronised_std, expected.synchronised))
        for simulated, predicted in pairs:
            assert math.sqrt(low) * 0.96 < simulated / predicted < math.sqrt(high) * 1.04, point.label
        assert abs(outcome.bias) < 5.5 * outcome.bias_error, point.label  # 1e-7 for all three


def test_each_point_has_random_numbers_of_its_own():
    points = [point for make in SECTIONS.values() for point in make().points]
    assert len({point.label for point in points}) == len(points)
    assert len({point.seeded(1).seed for point in points}) == len(points)
    assert points[0].seeded(1).seed != points[0].seeded(2).seed


def test_document_and_plots_of_some_figures(tmp_path):
    options = ['--trials', '40', '--only', 'fig6,fig10,fig12', '--jobs', '1', '--out', str(tmp_path / 'new')]
    assert reproduce.main(options) == 0
    text = (tmp_path / 'new/reproduction.md').read_text(encoding='utf-8')
    for name in ('fig6', 'fig10', 'fig12'):
        assert f'(reproduction/{name}.png)' in text
        assert (tmp_path / f'new/reproduction/{name}.png').read_bytes().startswith(b'\x89PNG')
    words = ' '.join(text.split())
    assert '40 simulated sweep pairs' in words and 'seed 1' in words and 'fig11' not in words
    assert sorted(p.name for p in (tmp_path / 'new').iterdir()) == ['reproduction', 'reproduction.md']


def test_number_of_processes_changes_nothing(tmp_path):
    for jobs in ('1', '2'):
        options = ['--trials', '30', '--only', 'fig12', '--jobs', jobs, '--out', str(tmp_path / jobs), '--seed', '7']
        assert reproduce.main(options) == 0
    for name in ('reproduction.md', 'reproduction/fig12.png'):
        assert (tmp_path / '1' / name).read_bytes() == (tmp_path / '2' / name).read_bytes()


@pytest.mark.parametrize(
    ('options', 'message'),
    [
        (['--only', 'fig6,fgi7', '--out', 'new'], "--only: unknown figure 'fgi7'; did you mean 'fig7'?"),
        (['--only', 'fig6'], '--only leaves out parts of the document: give --out DIR as well'),
        (['--trials', '1', '--out', 'new'], '--trials = 1 is outside 2 ... 10000000'),
        (['--jobs', '-1', '--out', 'new'], '--jobs = -1 is outside 0 ... 1024'),
        (['--estimator', 'papre', '--out', 'new'], "--estimator: unknown 'papre'; did you mean 'paper'?"),
        (['--out', 'old'], 'old/reproduction.md exists; --force replaces it'),
        (['--only', 'fig10', '--out', 'file'], 'file/reproduction: Not a directory'),
    ],
)
def test_wrong_options_are_named_in_one_line(options, message, tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    (tmp_path / 'old').mkdir()
    (tmp_path / 'old/reproduction.md').write_text('mine')
    (tmp_path / 'file').write_text('mine')
    assert reproduce.main(options) == 2
    assert capsys.readouterr().err == f'drfmcw reproduce: {message}\n'
    assert sorted(p.name for p in tmp_path.iterdir()) == ['file', 'old']
    assert (tmp_path / 'old/reproduction.md').read_text() == 'mine'


def test_document_in_the_repository_holds_what_the_code_computes():
    """Exact claims only; the simulated ones take a minute: ./drfmcw reproduce."""
    text = DOCUMENT.read_text(encoding='utf-8')
    for claim in claims.exact_claims():
        row = f'| {claim.where} | {claim.paper} | {claim.ours} | {claim.verdict} | {claim.why} |'
        assert row in text, 'run ./drfmcw reproduce'
    for name in SECTIONS:
        assert (DOCUMENT.parent / f'reproduction/{name}.png').is_file()
