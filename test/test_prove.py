"""The proof's judgement of findings, its resumable results and its report, on truths and findings written by hand."""

import re
from pathlib import Path

import numpy as np
import pytest

from drfmcw_diagnosis import prove
from drfmcw_diagnosis.judging import OUTCOMES, judge
from drfmcw_diagnosis.proof.cases import GROUPS, plans
from drfmcw_diagnosis.proof_report import Run, document, interval, theoretical_power, write_report
from drfmcw_physics.settings import ConfigurationError

SPUR = {'effect': 'spur', 'station': 'master', 'parameters': {'frequency': 2e5, 'level': -80.0}}
ECHO = {'effect': 'echo', 'station': None, 'parameters': {'excess_range': 7.0, 'relative_power': -30.0, 'phase': 1.0}}
DELAY = {'effect': 'delay_offset', 'station': None, 'parameters': {'delay': 0.1}}
OFFSET = {'effect': 'reference_offset', 'station': None, 'parameters': {'offset': -0.015}}
NOISE = {'effect': 'phase_noise', 'station': None, 'parameters': {'level': -88.0}}
JUMP = {'effect': 'phase_jump', 'station': 'slave', 'parameters': {'angle': 0.1, 'time': 5e-4}}


def truth(*effects, verdicts=('explained',), rivals=(), tolerated=(), levels=(), registered=True):
    """Return a truth as the seal holds it."""
    return {
        'verdicts': list(verdicts),
        'effects': [{**e, 'registered': registered, 'units': {}, 'd': {'total': 12.0}} for e in effects],
        'rivals': [[{'effect': e['effect'], 'station': e['station']}] for e in rivals],
        'tolerated': list(tolerated),
        'tolerated_levels': list(levels),
    }


def found(effect, factor=1.0, std=0.01, **changes):
    """Return an effect as a finding states it."""
    parameters = {n: {'value': factor * v, 'std': std, 'unit': ''} for n, v in effect['parameters'].items()}
    return {'effect': effect['effect'], 'station': effect['station'], 'parameters': parameters, **changes}


def finding(verdict, *effects, alternatives=(), levels=()):
    """Return a finding as the tool writes it."""
    return {
        'verdict': verdict,
        'effects': list(effects),
        'alternatives': [{'effects': [e], 'log_evidence_gain': 1.0} for e in alternatives],
        'locations': [{'level': level, 'station': None, 'share': 1.0 / len(levels)} for level in levels],
    }


TWINS = {'verdicts': ('ambiguous',), 'rivals': (OFFSET,)}
NULL = {'verdicts': ('consistent',), 'tolerated': ('phase_noise',), 'levels': ('noise', 'if_spectrum')}


@pytest.mark.parametrize(
    ('sealed', 'said', 'outcome'),
    [
        (truth(SPUR), finding('explained', found(SPUR)), 'right'),
        (truth(SPUR), finding('explained', found(SPUR, station='slave')), 'wrong'),
        (truth(SPUR), finding('explained', found(ECHO)), 'wrong'),
        (truth(SPUR), finding('explained', found(SPUR), found(ECHO)), 'wrong'),
        (truth(SPUR), finding('consistent'), 'missed'),
        (truth(SPUR), finding('unexplained', levels=['if_spectrum']), 'unnamed'),
        (truth(SPUR), finding('ambiguous', found(ECHO), alternatives=[found(SPUR)]), 'undecided'),
        (truth(SPUR), finding('ambiguous', found(ECHO), alternatives=[found(DELAY)]), 'wrong'),
        # two effects, in any order, both needed
        (truth(SPUR, ECHO), finding('explained', found(ECHO), found(SPUR)), 'right'),
        (truth(SPUR, ECHO), finding('explained', found(ECHO)), 'wrong'),
        # what the data cannot tell apart: all named, not one for certain
        (truth(DELAY, **TWINS), finding('ambiguous', found(DELAY), alternatives=[found(OFFSET)]), 'right'),
        (truth(DELAY, **TWINS), finding('ambiguous', found(OFFSET), alternatives=[found(DELAY)]), 'right'),
        (truth(DELAY, **TWINS), finding('ambiguous', found(DELAY), alternatives=[found(SPUR)]), 'wrong'),
        (truth(DELAY, **TWINS), finding('explained', found(OFFSET)), 'wrong'),
        (truth(DELAY, **TWINS), finding('explained', found(DELAY)), 'wrong'),
        # nothing concealed
        (truth(**NULL), finding('consistent'), 'right'),
        (truth(**NULL), finding('explained', found(NOISE)), 'right'),
        (truth(**NULL), finding('explained', found(NOISE), found(SPUR)), 'wrong'),
        (truth(**NULL), finding('unexplained', levels=['noise']), 'right'),
        (truth(**NULL), finding('unexplained', levels=['noise', 'range']), 'wrong'),
        (truth(**NULL), finding('unexplained'), 'wrong'),
        (truth(verdicts=('consistent',)), finding('explained', found(NOISE)), 'wrong'),
        # outside the registry
        (truth(JUMP, verdicts=('unexplained',), registered=False), finding('unexplained'), 'right'),
        (truth(JUMP, verdicts=('unexplained',), registered=False), finding('explained', found(SPUR)), 'wrong'),
        (truth(JUMP, verdicts=('unexplained',), registered=False), finding('consistent'), 'missed'),
    ],
)
def test_judgement(sealed, said, outcome):
    judgement = judge(sealed, said)
    assert judgement.outcome == outcome
    assert judgement.outcome in OUTCOMES and judgement.reason
    assert bool(judgement.pulls) == (bool(judgement.named) and judgement.named[0] == judgement.truth != frozenset())


def test_pulls_count_errors_in_stated_deviations():
    pulls = judge(truth(SPUR), finding('explained', found(SPUR, factor=1.001, std=40.0))).pulls
    assert {p.parameter: p.pull for p in pulls} == pytest.approx({'frequency': 5.0, 'level': -0.002})


def test_a_sign_that_a_phase_undoes_is_no_error():
    ripple = {'effect': 'sweep_ripple', 'station': 'slave', 'parameters': {'deviation': 50.0, 'phase': 0.5}}
    (pull,) = judge(truth(ripple), finding('explained', found(ripple, factor=-1.0))).pulls
    assert pull.parameter == 'deviation' and pull.pull == 0.0


def test_values_per_setting_are_compared_one_by_one():
    motion = {'effect': 'target_motion', 'station': None, 'parameters': {'velocity': [0.5, -1.0]}}
    stated = {f'velocity[{i}]': {'value': v, 'std': 0.1, 'unit': 'm/s'} for i, v in enumerate((0.6, -1.0))}
    said = finding('explained', {'effect': 'target_motion', 'station': None, 'parameters': stated})
    assert [p.pull for p in judge(truth(motion), said).pulls] == pytest.approx([1.0, 0.0])


def test_few_cases_go_around_groups_and_kinds():
    listed = plans('quick', 3)
    few = prove.chosen(listed, GROUPS, 5, 3)
    assert [p.name for p in few] == sorted(p.name for p in few)
    assert {p.group for p in few} == {p.group for p in listed}  # five groups, one of each
    assert few == prove.chosen(listed, GROUPS, 5, 3)
    assert prove.chosen(listed, ('null',), None, 3) == tuple(p for p in listed if p.group == 'null')
    assert len({p.kind for p in prove.chosen(listed, ('single',), 6, 3)}) == 6


SETTINGS = {'extent': 'quick', 'seed': 1, 'versions': {'drfmcw_sim': 'abc'}}


@pytest.mark.parametrize(
    ('change', 'words'), [({'seed': 2}, 'seed 1, not 2'), ({'versions': {'drfmcw_sim': 'abd'}}, 'another version')]
)
def test_results_of_another_run_are_refused_unless_discarded(tmp_path, change, words):
    with prove.Results(tmp_path / 'out', SETTINGS) as results:
        results.store({'name': 'recording_0000'})
    with prove.Results(tmp_path / 'out', SETTINGS) as results:
        assert results.record('recording_0000') == {'name': 'recording_0000'}
    with pytest.raises(ConfigurationError, match=words), prove.Results(tmp_path / 'out', SETTINGS | change):
        pass
    with prove.Results(tmp_path / 'out', SETTINGS | change, force=True) as results:
        assert results.record('recording_0000') is None


def test_a_directory_of_something_else_is_left_alone(tmp_path):
    (tmp_path / 'mine').write_text('text')
    for force in (False, True):
        with pytest.raises(ConfigurationError, match='holds no proof'), prove.Results(tmp_path, SETTINGS, force):
            pass
    assert [p.name for p in tmp_path.iterdir()] == ['mine']


def test_a_directory_in_use_is_refused(tmp_path):
    with (
        prove.Results(tmp_path / 'out', SETTINGS),
        pytest.raises(ConfigurationError, match='another run'),
        prove.Results(tmp_path / 'out', SETTINGS),
    ):
        pass


@pytest.mark.parametrize(
    'words',
    [['--groups', 'nul'], ['--cases', '0'], ['--jobs', '0'], ['--seed', '-1'], ['--quick', '--groups', 'decoy']],
)
def test_a_wrong_command_line_is_one_line_and_status_2(words, tmp_path, capsys):
    out = tmp_path / 'out'
    assert prove.main([*words, '--out', str(out)]) == 2
    assert capsys.readouterr().err.count('\n') == 1
    assert not out.exists()


def record(number, group, kind, sealed, said):
    """Return a case as it is stored."""
    return {
        'name': f'recording_{number:04d}', 'group': group, 'kind': kind, 'sha256': 'f' * 64, 'truth': sealed,
        'finding': said, 'judgement': judge(sealed, said).as_object(), 'seconds': 20.0 + number,
    }  # fmt: skip


def test_report_tells_numbers_and_every_failure(tmp_path):
    records = [
        record(0, 'null', 'right', truth(**NULL), finding('consistent')),
        record(1, 'null', 'bump', truth(**NULL), finding('unexplained', levels=['range'])),
        record(2, 'single', 'spur', truth(SPUR), finding('explained', found(SPUR, factor=1.0001))),
        record(3, 'single', 'echo', truth(ECHO), finding('explained', found(DELAY))),
        record(4, 'pair', 'echo + spur', truth(SPUR, ECHO), finding('explained', found(SPUR), found(ECHO))),
    ]
    records.append({
        **record(5, 'single', 'spur', truth(SPUR), finding('consistent')),
        'finding': None, 'judgement': {'outcome': 'failed', 'reason': 'a | in a line', 'named': [], 'pulls': []},
    })  # fmt: skip
    run = Run('./drfmcw prove --quick', 'quick', 7, 12, {'drfmcw_sim': 'abc'}, 0.5)
    write_report(tmp_path, run, records)
    text = (tmp_path / 'proof.md').read_text(encoding='utf-8')
    assert text == document(run, records)
    for words in ('./drfmcw prove --quick', '| seed | 7 |', 'has not been made', '| cases run | 6 |'):
        assert words in text
    failures = text.partition('## Not right, one by one')[2].partition('\n## ')[0]
    assert re.findall(r'recording_\d+', failures) == ['recording_0001', 'recording_0003', 'recording_0005']
    assert 'echo [excess_range 7' in failures and 'explained: delay_offset' in failures
    for plot in re.findall(r'!\[.*?\]\((.*?)\)', text):
        assert (tmp_path / plot).read_bytes().startswith(b'\x89PNG')
    for block in re.findall(r'(?:^\|.*\n)+', text, re.MULTILINE):  # every row of a table has its columns
        assert len({line.count('|') for line in block.splitlines()}) == 1


def test_report_of_nulls_alone_renders(tmp_path):
    run = Run('./drfmcw prove --groups null', 'full', 1, 4624, {}, 0.5)
    write_report(tmp_path, run, [record(0, 'null', 'right', truth(**NULL), finding('consistent'))])
    assert '1 of 4624 cases' in Path(tmp_path, 'proof.md').read_text(encoding='utf-8')


def test_intervals_hold_the_rate_and_theory_its_level():
    for k, n in ((0, 10), (3, 10), (10, 10)):
        low, high = interval(k, n)
        assert 0.0 <= low <= k / n <= high <= 1.0
    assert theoretical_power(np.array([5.85])) == pytest.approx(0.9, abs=1e-6)
    assert np.all(np.diff(theoretical_power(np.linspace(0.0, 12.0, 50))) > 0.0)
