"""Several recordings at once: combined effects, agreement, one bad recording beside good ones, JSON, table and page."""

import dataclasses
import json
import os
import signal

import numpy as np
import pytest
from scenes import record, scene

from drfmcw_diagnosis.diagnose import main
from drfmcw_diagnosis.finding.result import BeforeAfter, Diagnosis, Estimate, Explanation, Fit, FoundEffect
from drfmcw_diagnosis.several.elsewhere import answered, questions
from drfmcw_diagnosis.several.joint import Elsewhere, combined, joined, of_hardware, settled
from drfmcw_diagnosis.several.report import as_object, render_html, short_names
from drfmcw_diagnosis.several.running import Outcome, Place, each
from drfmcw_ros.bag.files import SKIP_DAMAGED
from drfmcw_sim.effects import Effect

STANDING = {'standing': {'distances': [150.0, 220.0, 300.0], 'sweeps': 8}}
RIPPLE = {'effect': 'sweep_ripple', 'station': 'slave', 'deviation': 2000.0, 'rate': 9000.0, 'phase': 0.5}
WITHOUT = ','.join(sorted(set(Effect.registry) - {'sweep_ripple'}))


def clock(value, std=0.02, station='slave', **changes):
    parameters = {'deviation': Estimate(value, std, 'ppm')}
    return FoundEffect('reference_clock_offset', station, parameters, 100.0, 1e-9, **changes)


def echo(length):
    return FoundEffect('echo', None, {'excess_range': Estimate(length, 0.01, 'm')}, 100.0, 1e-9)


def finding(path, *effects):
    explanation = Explanation(effects, 100.0) if effects else None
    verdict = 'explained' if effects else 'consistent'
    change = BeforeAfter(3.0, 1.0)
    return Diagnosis(
        path, verdict, 1e-9, 0.01, (), explanation, (), None, Fit(change, change), None, (), (),
        stations=('master', 'slave'),
    )  # fmt: skip


def test_estimates_are_combined_by_their_weights():
    """Two of 4.00 +- 0.02 and 4.05 +- 0.04 are 4.01 +- 0.0179; chi-square is the squared difference over variances."""
    parameters, chi_square, freedom = combined([clock(4.0, 0.02), clock(4.05, 0.04)])
    assert parameters['deviation'].value == pytest.approx(4.01)
    assert parameters['deviation'].std == pytest.approx((1 / 0.02**2 + 1 / 0.04**2) ** -0.5)
    assert (chi_square, freedom) == (pytest.approx(0.05**2 / (0.02**2 + 0.04**2)), 1)


def test_correlated_parameters_are_combined_along_their_valley():
    """Chi-square has the mean and the variance of its degrees of freedom, to 5 standard deviations of 2000 draws."""
    rng = np.random.default_rng(1)
    correlation = np.array([[1.0, 0.95], [0.95, 1.0]])
    stds = np.array([3.0, 1e-6])  # of units that differ by orders
    factor = np.linalg.cholesky(correlation) * stds[:, None]

    def drawn():
        values = factor @ rng.standard_normal(2)
        parameters = {'deviation': Estimate(values[0], stds[0], 'Hz'), 'rate': Estimate(values[1], stds[1], 'Hz')}
        return FoundEffect('sweep_ripple', 'slave', parameters, 1.0, 1e-9, correlation=tuple(map(tuple, correlation)))

    squares = np.array([combined([drawn(), drawn(), drawn()])[1] for _ in range(2000)])
    assert abs(squares.mean() - 4.0) < 5.0 * np.sqrt(8.0 / 2000)
    assert abs(squares.var() - 8.0) < 5.0 * 8.0 * np.sqrt(5.0 / 2000)


def test_whole_turns_of_a_phase_are_nothing():
    def turned(phase):
        return FoundEffect('sweep_ripple', 'slave', {'phase': Estimate(phase, 0.1, 'rad')}, 1.0, 1e-9)

    parameters, chi_square, _ = combined([turned(3.1), turned(3.1 - 2.0 * np.pi)])
    assert chi_square < 1e-9 and parameters['phase'].value == pytest.approx(3.1)


def test_hardware_is_shared_and_the_path_is_not():
    found = {'a': finding('a', clock(4.0), echo(7.0)), 'b': finding('b', clock(4.03), echo(9.0)), 'c': finding('c')}
    joint = joined(found)
    (question,) = questions(found, joint.shared, None)
    assert question.path == 'c' and [effect for effect, _, _ in question.asked] == ['reference_clock_offset']
    visible = settled(joint, [Elsewhere('c', 'reference_clock_offset', 'slave', 1.02, 0.1)])
    by_effect = {s.effect: s for s in visible.shared}
    assert by_effect['reference_clock_offset'].agrees and by_effect['echo'].parameters == {}
    absent = settled(joint, [Elsewhere('c', 'reference_clock_offset', 'slave', 0.02, 0.1)])
    (shared,) = (s for s in absent.shared if s.effect == 'reference_clock_offset')
    assert not shared.agrees and shared.contradicting == ('c',) and shared.probability > 0.01
    blind = settled(joint, [Elsewhere('c', 'reference_clock_offset', 'slave', 0.4, 0.5)])
    assert all(s.agrees for s in blind.shared if s.same_hardware)


def test_lists_of_values_go_with_each_recording_and_are_not_combined():
    lists = {name for name, kind in Effect.registry.items() if kind.list_parameters()}
    assert lists and not any(map(of_hardware, lists))


def test_what_one_recording_alone_holds_is_its_own():
    found = {'a': finding('a', clock(4.0), echo(7.0)), 'b': finding('b')}
    joint = settled(joined(found), [Elsewhere('b', 'reference_clock_offset', 'slave', 0.0, 0.05)])
    assert not joint.shared and {f.effect for f in joint.alone['a']} == {'reference_clock_offset', 'echo'}
    there = settled(joined(found), [Elsewhere('b', 'reference_clock_offset', 'slave', 1.0, 0.05)])
    assert [s.effect for s in there.shared] == ['reference_clock_offset'] and not there.alone['b']


def test_recordings_that_disagree_are_called_so():
    joint = settled(joined({'a': finding('a', clock(4.0)), 'b': finding('b', clock(4.3))}), [])
    (shared,) = joint.shared
    assert not shared.agrees and shared.probability < 1e-12


def killed(item):
    if item == 2:
        os.kill(os.getpid(), signal.SIGKILL)
    return item * item


@pytest.mark.parametrize('jobs', [1, 2])
def test_a_process_that_dies_does_not_cost_the_others(jobs):
    notes, done = [], []
    assert each(killed, [1, 2, 3, 4], Place(jobs), done.append, notes.append) == [1, None, 9, 16]
    assert len(notes) == 1 and 'SIGKILL' in notes[0] and done[-1] == 3


def skips(_):
    return SKIP_DAMAGED.get()


@pytest.mark.parametrize('skip', [True, False])
def test_workers_skip_damage_where_the_command_line_says_so(skip):
    """A new process begins with the default."""
    before = SKIP_DAMAGED.set(skip)
    try:
        assert each(skips, [1], Place(1), lambda _: None, print) == [skip]
    finally:
        SKIP_DAMAGED.reset(before)


def test_no_scheduler_is_one_line(tmp_path, capsys):
    assert main(['a', 'b', '--scheduler', 'localhost']) == 2
    assert 'expected an address like tcp://host:8786' in capsys.readouterr().err


def test_short_names_are_distinct():
    assert list(short_names(['/x/run', '/y/run', '/z/other']).values()) == ['run', 'run_2', 'other']


def test_page_holds_what_is_shared_and_what_is_not_and_names_are_escaped():
    found = {'/r/a<b>': finding('/r/a<b>', clock(4.0), echo(7.0)), '/r/b': finding('/r/b', clock(4.03))}
    outcomes = [*(Outcome(path, d) for path, d in found.items()), Outcome('/r/c', None, '/r/c: no such recording')]
    names = short_names([o.path for o in outcomes])
    joint = settled(joined(found), [])
    page = render_html(outcomes, joint, names, {'/r/b': 'b/report.html'}, './drfmcw diagnose a b c')
    for text in (
        'a&lt;b&gt;',
        'no such recording',
        'href="b/report.html"',
        'agree',
        'What each has alone',
        'data:image/png',
    ):
        assert text in page, text
    assert 'a<b>' not in page and 'http' not in page and '<script' not in page
    held = as_object(outcomes, joint, names)
    assert held == json.loads(json.dumps(held, allow_nan=False))
    assert held['recordings'][2] == {
        'recording': '/r/c', 'name': 'c', 'error': '/r/c: no such recording', 'finding': None,
    }  # fmt: skip


def test_an_effect_that_was_not_found_is_asked_for(tmp_path):
    """Scale 1 where it acts and 0 where it does not, within 4 standard deviations; the recordings are fixed."""
    parameters = {name: Estimate(RIPPLE[name], 1.0, '') for name in ('deviation', 'rate', 'phase')}
    ripple = FoundEffect('sweep_ripple', 'slave', parameters, 1.0, 1e-9)
    for name, effects, expected in (('with', [RIPPLE], 1.0), ('without', [], 0.0)):
        path = record(scene(STANDING, effects=effects, reference={'range_std': 0.005}, seed=3), tmp_path / name)
        found = {'other': finding('other', ripple), str(path): finding(str(path))}
        (question,) = questions(found, joined(found).shared, None)
        (answer,) = answered(dataclasses.replace(question, path=str(path)))
        assert abs(answer.scale - expected) < 4.0 * answer.std and answer.std < 0.1


def test_one_bad_recording_costs_one_line_and_the_others_share_their_ripple(tmp_path, capfd):
    paths = [
        str(record(scene(STANDING, effects=[RIPPLE], reference={'range_std': 0.005}, seed=seed), tmp_path / f'r{seed}'))
        for seed in (1, 2)
    ]
    out = tmp_path / 'out'
    status = main([*paths, str(tmp_path / 'absent'), '--without', WITHOUT, '--out', str(out), '--jobs', '2'])
    printed = capfd.readouterr()
    assert status == 2
    assert printed.err.splitlines() == [f'drfmcw diagnose: {tmp_path / "absent"}: no such recording']
    assert 'Shared: sweep ripple at slave' in printed.out and 'not read' in printed.out
    held = json.loads((out / 'joint.json').read_text(encoding='utf-8'))
    (shared,) = held['shared']
    assert shared['agrees'] and shared['recordings'] == paths
    for name, estimate in shared['parameters'].items():
        assert abs(estimate['value'] - RIPPLE[name]) < 4.0 * estimate['std'], name
    own = json.loads((out / 'r1/finding.json').read_text(encoding='utf-8'))
    assert own == held['recordings'][0]['finding'] and own['verdict'] == 'explained'
    assert {p.name for p in out.iterdir()} == {'r1', 'r2', 'joint.json', 'joint.html'}
    assert {p.name for p in (out / 'r2').iterdir()} == {'finding.json', 'report.html', 'refined.yaml'}
