"""Calibrating on site: what ranges beside a reference correct, what they do not, and where that holds."""

import dataclasses
import math

import numpy as np
import pytest
from checkout import DATA, ROOT

from drfmcw_commissioning.calibrate import main
from drfmcw_commissioning.recordings import read_ranges
from drfmcw_commissioning.site.candidates import candidates, changed, response
from drfmcw_commissioning.site.command import calibrate_site
from drfmcw_commissioning.site.fit import fit_site
from drfmcw_commissioning.site.groups import Group, gather
from drfmcw_commissioning.site.report import sentences
from drfmcw_commissioning.site.result import corrected
from drfmcw_commissioning.site.separability import Separability
from drfmcw_diagnosis.compare.comparison import Comparison
from drfmcw_diagnosis.recording.dataset import read_dataset
from drfmcw_diagnosis.search.fits.fitting import Fitting
from drfmcw_diagnosis.search.starts.bank import Candidate as Searched
from drfmcw_fusion.combination import combine
from drfmcw_fusion.displacement import displacement, with_line
from drfmcw_fusion.offline import replay_recording
from drfmcw_fusion.replayed.statistics import setting_statistics
from drfmcw_fusion.settings import FusionSettings
from drfmcw_fusion.uncertainty import Weather, contributions, delay_std
from drfmcw_node.estimators.estimation import EstimatorSettings
from drfmcw_physics.constants import SPEED_OF_LIGHT
from drfmcw_physics.oscillators import Calibration
from drfmcw_physics.sweep import Mode, SweepSettings, beat_frequency
from drfmcw_ros.calibration.document import (
    Clock,
    Document,
    Temperatures,
    from_calibration,
    matrix,
    read_document,
    triangle,
)
from drfmcw_sim.effects import Effect, Of, Stated
from drfmcw_sim.recording import write_recording
from drfmcw_sim.scenario import scenario_from_mapping

PRACTICE = next(
    (p for p in (ROOT / '../shared', ROOT / '../../shared') if p.exists()), ROOT / 'nowhere'
) / 'recordings/practice'  # fmt: skip
STATIONS = ('master', 'slave')
PAIR = Calibration('master', delay=12e-9), Calibration('slave', delay=15e-9)
DISTANCES = (40.0, 120.0, 300.0, 500.0, 700.0, 850.0, 1000.0)
AIR = 1.0  # standard deviation of the refractivity [1e-6]
INDEX = 1.0003  # refractive index of the air
NOTHING = Separability((), (), (), (), 0)


def settings_at(distance):
    mode, late = (Mode.LONG_DISTANCE, 0.6e-6) if distance > 650.0 else (Mode.SHORT_DISTANCE, 3.41e-6)
    return tuple(
        SweepSettings(*names, role=role, mode=mode, start_delay=late)
        for role, names in ((1, STATIONS), (2, STATIONS[::-1]))
    )


def group(distance, error=0.0, excess=0.0, boards=(25.0, 25.0), std=1e-3):
    sweeps = settings_at(distance)
    return Group(distance, error, std, 0.0, excess, 0.4e-9, boards, INDEX, sweeps, tuple(range(24)), 0)


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
        {(Stated.DELAY, 1): 0.5},
        {(Stated.CLOCK, 0): -8.0},
        {(Stated.DELAY, 1): -0.3, (Stated.CLOCK, 1): 5.0},
        {(Stated.DELAY_SLOPE, 0): 6.0},
        {(Stated.CLOCK_SLOPE, 1): 0.4, (Stated.DELAY, 1): 0.2},
        {(Stated.SAMPLE_CLOCK, 0): 20.0},
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
    amounts = {(Stated.DELAY, 1): 0.5, (Stated.CLOCK, 0): -8.0}
    pulls = []
    for seed in range(30):
        corrections = found(fitted(groups_with(amounts, seed=seed + 10)))
        pulls.append([(corrections[key][0] - amounts[key]) / corrections[key][1] for key in amounts])
    squares = np.mean(np.square(pulls), axis=0)
    assert squares[0] == pytest.approx(1.0, abs=0.8)
    assert squares[1] < 1.0, 'T_off is trusted to 10 ns only, but exact here'


def test_a_common_scale_of_both_clocks_is_not_pretended_to_be_one_clock():
    """With clocks stated to 0.02 ppm, 8 ppm of scale can only be the air, which no station holds."""
    stds = {'alpha_std': 2e-8, 'sample_clock_alpha_std': 2e-8, 'delay_std': 2e-11}
    stated = tuple(Calibration(c.station, delay=c.delay, **stds) for c in PAIR)
    fit = fitted(groups_with({(Stated.AIR, -1): 8.0}), stated, air_std=10.0)
    assert found(fit).keys() == {(Stated.AIR, -1)}


def test_a_distance_that_no_calibration_explains_is_left_out_and_named():
    groups = groups_with({(Stated.DELAY, 1): 0.5})
    bent = groups[2]
    groups[2] = group(bent.distance, bent.error + 0.05, bent.excess, bent.board)
    fit = fitted(groups)
    assert list(fit.explained) == [i != 2 for i in range(len(groups))]
    assert found(fit)[Stated.DELAY, 1][0] == pytest.approx(0.5, abs=0.03)
    left_out = sentences(dataclasses.replace(fit, corrections=(), undetermined=()), NOTHING, STATIONS)
    assert any('Left out: 300.0 m' in line and 'diagnose' in line for line in left_out)


def test_where_too_many_distances_are_off_by_themselves_nothing_is_corrected():
    """Errors of 30 mm each, of no order: numbers enough could follow most of them."""
    random = np.random.default_rng(4)
    fit = fitted([group(d, error=0.03 * float(random.standard_normal())) for d in np.linspace(40.0, 1000.0, 12)])
    assert not fit.corrections and not fit.explained.any() and not fit.undetermined
    documents = [from_calibration(c) for c in PAIR]
    assert corrected(documents, fit) == (documents, [])


def test_what_cannot_be_seen_here_is_no_correction():
    """At 100 m alone a clock's scale is hidden behind T_off's tolerance: it could displace ranges."""
    boards = [(25.0 + i, 25.0 + i) for i in range(4)]
    fit = fitted(groups_with({}, distances=(100.0,) * 4, boards=boards))
    assert not fit.corrections and all(u.displacement > 1e-3 and u.std > 0.0 for u in fit.undetermined)


def documents_of(fit, pair=PAIR):
    return corrected([from_calibration(c) for c in pair], fit)[0]


@pytest.mark.parametrize(
    'amounts', [{}, {(Stated.CLOCK, 1): 12.0}, {(Stated.CLOCK_SLOPE, 0): -0.35}, {(Stated.DELAY_SLOPE, 0): 6.0}]
)
def test_both_stations_state_how_uncertain_they_are(amounts):
    """Whatever is corrected: so the fusion counts what does not average, a millimetre or two here."""
    fit = fitted(groups_with(amounts))
    documents = documents_of(fit)
    pair = [d.calibration() for d in documents]
    for document, calibration in zip(documents, pair, strict=True):
        assert 0.0 < calibration.alpha_std < 2e-6 and 0.0 < calibration.sample_clock_alpha_std < 1e-5
        assert document.delay.slope_std > 0.0
        for clock in (document.reference_clock, document.sample_clock):
            spread = matrix(clock.covariance)
            excess = np.array([g.board[documents.index(document)] for g in fit.groups]) - 25.0
            at_boards = np.sqrt(spread[0, 0] + 2.0 * excess * spread[0, 1] + excess**2 * spread[1, 1])
            assert clock.std >= np.max(at_boards) * (1.0 - 1e-9), 'the largest over the temperatures of the site'
    assert documents[1].delay.peer == 'master' and 0.1e-3 < delay_std(*pair) * SPEED_OF_LIGHT < 3e-3


def remaining(seed):
    """True errors of a corrected site at other distances and temperatures, and what the fusion states of each [m].

    All numbers are off at once, each by no more than a site hardly notices.
    """
    random = np.random.default_rng(seed)
    distances = np.linspace(40.0, 1000.0, 12)
    boards = [tuple(25.0 + 8.0 * random.standard_normal() + 2.0 * random.standard_normal(2)) for _ in distances]
    plain = [group(d, boards=b) for d, b in zip(distances, boards, strict=True)]
    offered, true = candidates(PAIR, plain, AIR), PAIR
    for candidate, size in zip(offered, (0.02, 0.5, 0.5, 0.02, 0.5, 0.02, 0.5, 2.0, 2.0, 0.0), strict=True):
        true = changed(candidate, true, size * random.standard_normal())

    def off(distance, board, stated):
        pairs = [[c.at(t) for c, t in zip(pair, board, strict=True)] for pair in (stated, true)]
        return displacement(settings_at(distance), *pairs, distance, INDEX)

    groups = []
    for d, b in zip(distances, boards, strict=True):
        error, excess = off(d, b, PAIR)
        groups.append(group(d, error + 1e-3 * random.standard_normal(), excess + 0.4e-9 * random.standard_normal(), b))
    stated = tuple(d.calibration() for d in documents_of(fit_site(groups, PAIR, offered)))
    found = []
    for distance in random.uniform(40.0, 1000.0, 6):
        board = tuple(25.0 + 6.0 * random.standard_normal() + 2.0 * random.standard_normal(2))
        found.append((off(distance, board, stated)[0], correlated(distance, board, stated)))
    return found


def correlated(distance, board, calibrations):
    """What the fusion states of a range beside its noise [m]."""
    pair, sweeps = [c.at(t) for c, t in zip(calibrations, board, strict=True)], settings_at(distance)
    delay = distance * INDEX / SPEED_OF_LIGHT + sum(c.delay for c in pair)
    clocks = [c.alpha for c in pair]
    lines = [
        beat_frequency(s, delay, *clocks[:: 1 - 2 * i]) / c.sample_clock_alpha
        for i, (s, c) in enumerate(zip(sweeps, pair, strict=True))
    ]
    stations = [with_line(s, c, f) for s, c, f in zip(sweeps, pair, lines, strict=True)]
    return contributions(*stations, combine(*stations), Weather(15.0, 1e5, 0.5), 'vacuum').total


def test_what_is_left_of_the_errors_is_as_large_as_stated():
    """20 sites: chi-square 1 if exact; what several numbers could explain, each states, so it is less."""
    errors = np.concatenate([remaining(seed) for seed in range(20)])
    assert 0.1 < np.mean((errors[:, 0] / errors[:, 1]) ** 2) < 1.0
    assert np.sqrt(np.mean(errors**2, axis=0)) == pytest.approx([1.0e-3, 2.3e-3], rel=0.1)


def test_what_the_calibration_states_stays_where_nothing_is_corrected():
    stds = {'alpha_std': 2e-8, 'sample_clock_alpha_std': 3e-8, 'delay_std': 2e-11}
    stated = tuple(Calibration(c.station, delay=c.delay, **stds) for c in PAIR)
    before = [from_calibration(c) for c in stated]
    for old, new in zip(before, corrected(before, fitted(groups_with({}), stated))[0], strict=True):
        assert (new.reference_clock, new.sample_clock) == (old.reference_clock, old.sample_clock)
        assert (new.delay.std, new.delay.peer) == (old.delay.std, '')


def test_higher_orders_of_a_curve_follow_the_corrected_value():
    """Calibrated indoors, then aged by 2 ppm: how the value's error goes with that of the cubic part stays stated."""
    powers = np.linspace(-35.0, 20.0, 12)[:, None] ** np.arange(4)
    indoors = np.linalg.inv(powers.T @ powers) * 1e-6**2
    clock = Clock(1.0, 1e-6, -1e-7, 0.0, 1e-10, triangle(indoors))
    aged = Document('master', temperature=Temperatures(25.0, -10.0, 45.0), reference_clock=clock)
    pair = aged.calibration(), PAIR[1]
    groups = groups_with({(Stated.CLOCK, 0): 2.0})
    fit = fit_site(groups, pair, candidates(pair, groups, AIR))
    (new, _), _ = corrected([aged, from_calibration(PAIR[1])], fit)
    spread = matrix(new.reference_clock.covariance)
    assert new.reference_clock.value == pytest.approx(1.0 + 2e-6, abs=5e-7)
    assert (new.reference_clock.cubic, new.temperature) == (1e-10, aged.temperature)
    assert np.linalg.eigvalsh(spread / np.sqrt(np.outer(*2 * [np.diag(spread)])))[0] > -1e-9
    assert spread[0, 0] < indoors[0, 0] and spread[3, 3] < indoors[3, 3] * (1.0 + 1e-9)
    assert new.reference_clock.std < clock.std


def test_numbers_that_a_site_corrects_are_errors_that_effects_are():
    """Each is the error of one effect, which displaces the range of a recording by as much per unit."""
    kinds = [effect.error_of for effect in Effect.registry.values() if effect.error_of is not None]
    assert sorted(kinds) == sorted(Stated), 'one effect each'
    path = str(DATA / 'recording_0')
    data, ranges = read_dataset(path), read_ranges(path)
    groups = gather(ranges)
    rows = [np.flatnonzero(np.isin(data.stamp, g.stamps)) for g in groups]
    assert all(len(r) == g.count for r, g in zip(rows, groups, strict=True))
    comparison = Comparison(data)
    order = np.argsort([data.distance[m].mean() for m in comparison.members])
    for candidate in candidates(ranges.calibrations, groups, AIR):
        kind = next(e for e in Effect.registry.values() if e.error_of is candidate.kind)
        station = {'station': STATIONS[candidate.station]} if kind.of is Of.STATION else {}
        effect = kind(**{kind.recipes[0].size: 1.0}, **station)
        shift = (comparison.predict((effect,)).range - comparison.plain.range)[order]
        expected = response(candidate, groups, ranges.calibrations)[0]
        assert shift == pytest.approx(expected, rel=0.02, abs=1e-5), candidate.title(STATIONS)


def site(tmp_path, *effects, distances=(40, 200, 500, 900)):
    """A recording that conceals effects; returns its path."""
    scene = scenario_from_mapping(
        {
            'stations': {'master': {'delay': 12e-9}, 'slave': {'delay': 15e-9}},
            'pairs': [{'first': 'master', 'second': 'slave', 'standing': {'distances': list(distances), 'sweeps': 16}}],
            'reference': {'range_std': 0.002},
            'effects': list(effects),
            'seed': 8,
        },
        'test',
    )
    path = tmp_path / 'site'
    write_recording(scene, path)
    return str(path)


LONGER = {'effect': 'delay_offset', 'delay': 0.4}


def test_result_is_a_document_that_replay_loads(tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    path = site(tmp_path, LONGER)
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
    path = site(tmp_path, LONGER)
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


def test_one_distance_cannot_separate_a_delay_from_an_error_of_the_reference(tmp_path, capsys):
    """The reference is 15 mm off. It is trusted, and named; a second distance or another instrument decides."""
    path = site(tmp_path, {'effect': 'reference_offset', 'offset': 0.015}, distances=(200,))
    site_ = calibrate_site(path)
    (correction,) = site_.fit.corrections
    assert correction.candidate.kind is Stated.DELAY
    assert correction.value == pytest.approx(-0.015 / 0.2998, abs=5.0 * correction.std)
    titles = [[size.title for size in rival.sizes] for rival in site_.separability.rivals]
    (zero,) = (i for i, names in enumerate(titles) if names == ['zero of the reference instrument'])
    (offset,) = site_.separability.rivals[zero].sizes
    assert (offset.value, offset.unit) == (pytest.approx(0.015, abs=5.0 * offset.std), 'm')
    assert site_.separability.rivals[zero].distance < 1.0
    decides = [m.sentence for m in site_.separability.deciding if zero in m.ruled_out]
    assert decides and all('known baseline' in sentence or 'second instrument' in sentence for sentence in decides)
    said = ' '.join(site_.sentences)
    assert 'zero of the reference instrument +15' in said and f'Decisive measurement: {decides[0]}' in said
    assert "Not determined here: ADC clock beside the reference of 'master'" in said
    assert 'This would show it: Read the ADC clock of each station with a frequency counter' in said


def test_several_corrections_may_all_be_something_else(tmp_path):
    """A delay and a clock: the zero of the reference and the other clock, both at once, fit as well."""
    clock = {'effect': 'reference_clock_offset', 'station': 'slave', 'deviation': 1.5}
    found = calibrate_site(site(tmp_path, LONGER, clock, distances=(40, 200, 350, 500, 900)))
    assert {c.candidate.kind for c in found.fit.corrections} == {Stated.DELAY, Stated.CLOCK}
    both = {'zero of the reference instrument', "reference clock of 'master'"}
    assert any({size.title for size in rival.sizes} == both for rival in found.separability.rivals)
    ruled_out = frozenset().union(*(m.ruled_out for m in found.separability.deciding))
    assert ruled_out == set(range(len(found.separability.rivals))), 'these measurements together leave no rival'


def test_what_disturbs_the_samples_alone_corrects_nothing():
    """PLL settling, by another hand: it resembles a clock that is off by 0.46 ppm, which ranges and T_off refute."""
    path = str(DATA / 'recording_6')
    kind = next(e for e in Effect.registry.values() if e.error_of is Stated.CLOCK)
    fitting = Fitting(Comparison(read_dataset(path)))
    start = {kind.recipes[0].size: 0.1}
    (effect,) = fitting.fit([(Searched(kind.name, 'slave', kind.recipes[0], start), start)]).effects
    ((name, value),) = effect.values.items()
    assert value == pytest.approx(0.46, abs=0.02) and value > 100.0 * effect.stds[name]
    assert not calibrate_site(path).fit.corrections


def test_a_site_that_no_calibration_explains_is_refused(tmp_path, monkeypatch, capsys):
    """The crane moves, differently at each distance, and nobody says so."""
    monkeypatch.chdir(tmp_path)
    assert main(['site', str(DATA / 'recording_5')]) == 2
    said = capsys.readouterr()
    assert 'No correction: no calibration explains two thirds' in said.out
    assert said.err.endswith('no calibration explains this site; nothing is written\n')
    assert not list(tmp_path.iterdir())


def test_marks_are_no_better_than_stated(tmp_path):
    """105 mm at 200 and at 400 m: marks to 20 mm separate a delay from the air by 47 mm, 2.3 standard deviations."""
    path = site(tmp_path, {'effect': 'delay_offset', 'delay': 0.35}, distances=(200, 400))
    rivals = {}
    for std in (0.0005, 0.02):
        (tmp_path / 'marks.csv').write_text(f'range,std\n200,{std}\n400,{std}\n')
        found = calibrate_site(path, str(tmp_path / 'marks.csv'))
        names = [[size.title for size in rival.sizes] for rival in found.separability.rivals]
        rivals[std] = ['refractivity of the air'] in names
    assert rivals == {0.0005: False, 0.02: True}


@pytest.mark.skipif(not PRACTICE.exists(), reason='lies in shared/recordings only')
@pytest.mark.parametrize(
    ('number', 'kind', 'station', 'truth', 'by_samples', 'stated'),
    [
        (1, Stated.CLOCK, 1, 12.0, 0.0062, 1.3e-3),
        (3, Stated.CLOCK_SLOPE, 0, -0.35, 0.00024, 1.4e-3),
        (7, Stated.DELAY_SLOPE, 0, 6.0, 0.34, 1.75e-3),
    ],
)
def test_practice_recordings_are_without_bias_afterwards(number, kind, station, truth, by_samples, stated):
    """By another hand: the concealed error is the one corrected, and no bias stays beyond 1 mm + 3 sigma / sqrt(n).

    The samples say the same, nothing else fits as well, and both stations state what is left (docs/calibration.md).
    """
    path = str(PRACTICE / f'recording_{number}')
    found_ = calibrate_site(path)
    fit = found_.fit
    ((key, (value, std)),) = found(fit).items()
    assert key == (kind, station) and value == pytest.approx(truth, abs=4.0 * std)
    (seen,) = found_.separability.by_samples
    assert seen.std == pytest.approx(by_samples, rel=0.1)
    assert seen.value == pytest.approx(truth, abs=4.0 * seen.std)
    assert not found_.separability.rivals
    replay = replay_recording(
        path,
        EstimatorSettings(estimator='ml'),
        FusionSettings(velocity='standing'),
        calibrations=[document.calibration() for document in found_.documents],
    )
    assert min(r.correlated_std for r in replay.results) > 0.5 * stated
    assert np.mean([r.correlated_std for r in replay.results]) == pytest.approx(stated, rel=0.1)
    determined = {round(g.distance) for g, good in zip(fit.groups, fit.explained, strict=True) if good}
    rows = [r for r in setting_statistics(replay.results, replay.reference) if round(r.reference) in determined]
    assert len(rows) >= 12
    for row in rows:
        assert abs(row.bias) < 1e-3 + 3.0 * row.std / math.sqrt(row.n), row.reference
    chi_square = np.mean([row.bias**2 / (stated**2 + row.std**2 / row.n) for row in rows])
    assert 0.1 < chi_square < 1.0, 'noise of reference and ranges dominates'
