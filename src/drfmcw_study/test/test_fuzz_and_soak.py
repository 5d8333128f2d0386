"""What fuzzing has found stays right, the fuzzer finds what is wrong, and hours of sweeps leave nothing behind."""

import math
import os
from pathlib import Path

import numpy as np
import pytest

from drfmcw_study.campaign.fuzz import Found, attempt, fuzz, summary
from drfmcw_study.campaign.fuzz_targets import Target, targets
from drfmcw_study.soak import GROWTH_LIMIT, Look, Soak, judged, leaks, run, slope, table

CORPUS = Path(__file__).parent / 'corpus'
TARGETS = targets()


@pytest.mark.parametrize('target', TARGETS, ids=lambda t: t.name)
def test_corpus_raises_nothing(target):
    """Seeds, and inputs that reached lines of their own in earlier fuzzing."""
    found = Found(target, [*target.seeds(), *(p.read_bytes() for p in sorted((CORPUS / target.name).glob('*')))])
    for data in found.corpus:
        attempt(found, data)
    assert found.lines and not found.failures


def _three_keys(data):
    """Fail for one input in 2^24: no chance without the guidance of the lines reached."""
    from drfmcw_node.sources import sealing

    if data[:1] == b'k':
        sealing.new_session()
        if data[1:2] == b'e':
            sealing.encode_hello(bytes(16))
            if data[2:3] == b'y':
                raise ZeroDivisionError


def test_fuzzer_finds_what_only_coverage_leads_to(tmp_path):
    """Three bytes in turn, each rewarded with new lines; 20 s, of which it takes about one."""
    target = Target('three', 'three keys', lambda: [b'....'], _three_keys, (b'k', b'e', b'y'))
    state = fuzz([target], 0.1, 1, tmp_path)
    assert any('ZeroDivisionError' in failure for failure in state[0].failures)
    assert len(list((tmp_path / 'three').iterdir())) >= 2 and 'three keys' in summary(state)


def test_slope_covers_the_truth_in_95_percent():
    """1000 lines with noise: 95 % of the intervals hold the slope, within 4 standard deviations of 0.7 %."""
    rng = np.random.default_rng(2)
    hours = np.linspace(0.0, 5.0, 30)
    held = 0
    for _ in range(1000):
        found = slope(hours, 3.0 + 0.2 * hours + rng.normal(0.0, 1.0, 30))
        held += abs(found.value - 0.2) <= found.half_width
    assert 922 <= held <= 978


def test_a_leak_is_found_and_none_is_not():
    leaking = [Look(i * 0.1, 100.0 + 0.5 * i, 10 + i, 1.0) for i in range(50)]
    found = judged(leaking)
    assert found['memory'].value == pytest.approx(120.0) and found['memory'].grows and found['descriptors'].grows
    assert len(leaks(leaking)) == 2 and '| memory [MB] | 105 | 124.5 | +1.2e+02' in table(leaking)
    flat = [Look(i * 0.1, 100.0, 10, 1.0) for i in range(50)]
    assert not any(found.grows for found in judged(flat).values()) and not leaks(flat)
    assert math.isinf(judged([Look(0.0, 1.0, 1, 1.0)])['memory'].half_width)


def test_growth_is_refused_by_what_it_may_be_and_not_by_what_it_is():
    """Memory that scatters by 10 MB within 2 h may grow by more in 24 h than is allowed, whatever its slope."""
    rng = np.random.default_rng(3)
    short = [Look(hours, 100.0 + rng.normal(0.0, 10.0), 10, 1.0) for hours in np.linspace(0.0, 2.0, 50)]
    assert len(leaks(short)) == 1 and f'more than {GROWTH_LIMIT:g}' in leaks(short)[0]
    assert leaks([Look(0.0, 1.0, 1, 1.0)])


@pytest.mark.slow
def test_sweeps_leave_no_descriptors_behind():
    looks = run(0.02, 120.0, Soak('hann'))
    assert looks[-1].hours >= 0.02
    assert len({look.descriptors for look in looks}) == 1


@pytest.mark.slow
def test_gateway_and_its_clients_leave_no_descriptors_behind():
    """Clients of both protocols come and go, one of them encrypted; each pair and then both fall silent.

    Both clients see each silence at the simulated time at which the default time-outs promise it: a wrong quality,
    status, range or heartbeat raises. Memory cannot be judged in so short a time: `./drfmcw soak --gateway`.
    """
    pytest.importorskip('asyncua')
    from drfmcw_study.soak_gateway import RANGES, SILENCE_EVERY, GatewaySoak

    soak = GatewaySoak()
    try:
        assert soak.process != os.getpid()
        looks = run(3 * SILENCE_EVERY / 50 / 3600, 600.0, soak)
        assert soak.silences == 3 and soak.visits >= 3 * SILENCE_EVERY // RANGES - 1 and soak.secured >= 2
        assert soak.notified > soak.visits
        assert len({look.descriptors for look in looks}) == 1
    finally:
        soak.close()
