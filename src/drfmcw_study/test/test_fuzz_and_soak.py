"""What fuzzing has found stays right, the fuzzer finds what is wrong, and hours of sweeps leave nothing behind."""

import math
import time
from pathlib import Path

import numpy as np
import pytest

from drfmcw_study.campaign.fuzz import Found, attempt, fuzz, summary
from drfmcw_study.campaign.fuzz_targets import Target, targets
from drfmcw_study.soak import Look, Soak, judged, run, slope

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
    leak = judged([Look(i * 0.1, 100.0 + 0.5 * i, 10 + i, 1.0) for i in range(50)])
    assert leak['memory'].value == pytest.approx(5.0) and leak['memory'].grows and leak['descriptors'].grows
    flat = judged([Look(i * 0.1, 100.0, 10, 1.0) for i in range(50)])
    assert not any(found.grows for found in flat.values())
    assert math.isinf(judged([Look(0.0, 1.0, 1, 1.0)])['memory'].half_width)


@pytest.mark.slow
def test_sweeps_leave_no_descriptors_behind():
    looks = run(0.02, 120.0, Soak('hann'))
    assert looks[-1].hours >= 0.02
    assert len({look.descriptors for look in looks}) == 1


def _fewest_descriptors():
    """Return the number of open descriptors when the servers have closed their side of clients that have left."""
    found = []
    for _ in range(30):
        found.append(len(list(Path('/proc/self/fd').iterdir())))
        time.sleep(0.1)
    return min(found)


@pytest.mark.slow
def test_gateway_and_its_clients_leave_no_descriptors_behind():
    """Clients of both protocols come and go between looks; a subscription stays and gets what changes."""
    pytest.importorskip('asyncua')
    from drfmcw_study.soak_gateway import RANGES, GatewaySoak

    soak = GatewaySoak()
    try:
        soak.loop()
        before = _fewest_descriptors()
        notified = soak.notified
        soak.loop()
        assert soak.hours == pytest.approx(2 * RANGES / 50 / 3600)
        assert soak.notified > notified
        assert _fewest_descriptors() <= before
    finally:
        soak.close()
