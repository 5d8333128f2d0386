"""The bench: what it compares with does the job that it is compared on, and goals are met on their side."""

import os
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

sys.path.append(str(Path(__file__).parents[1] / 'benchmarks'))
import references  # noqa: E402
from figures import Figure  # noqa: E402
from measuring import rates  # noqa: E402
from rich.console import Console  # noqa: E402

RATE = 2.048e6
CHIRP_RATE = 150e9
SWEEPS = 64


@pytest.mark.parametrize('start_delay', [3.41e-6, 0.6e-6])
def test_reference_estimators_find_the_lines(start_delay):
    """Mean of 64 sweeps at k (T_off + tau) and k |T_off - tau|: each scatters by 3 Hz, asserted to 2 Hz, 5 sigma."""
    delay = 700e-9 if start_delay > 1e-6 else 2e-6
    pair = references.two_station_if(SWEEPS, 1, delay, start_delay)
    first, second = CHIRP_RATE * (start_delay + delay), CHIRP_RATE * abs(start_delay - delay)
    for estimate in (references.frequency_by_zoom_fft, references.frequency_by_matrix):
        assert np.mean(estimate(pair[0], RATE)) == pytest.approx(first, abs=2.0)
        assert np.mean(estimate(pair[1], RATE)) == pytest.approx(second, abs=2.0)
    sign = -1 if start_delay > delay else 1
    sums = references.beat_sum_by_product(*pair, RATE, sign)
    assert sums.shape == (SWEEPS,)
    assert np.mean(sums) == pytest.approx(2.0 * CHIRP_RATE * delay, abs=2.0)


def test_goal_is_met_on_its_side():
    assert Figure('a', 2.0, goal=1.0).met is False
    assert Figure('a', 2.0, goal=1.0, relation='>=').met is True
    assert Figure('a', 2.0).met is None
    assert Figure('a', 2.0, bound=1.0, reference=3.0, reference_name='b').as_object()['reference'] == 3.0


def test_rates_are_measured_in_turns_on_one_core():
    """Each job gets its turns, and the process has all its cores back afterwards."""
    cores, order = os.sched_getaffinity(0), []

    def job(name):
        assert len(os.sched_getaffinity(0)) == 1
        if order[-1:] != [name]:
            order.append(name)
        return 1

    rate = rates({'a': lambda: job('a'), 'b': lambda: job('b')}, 0.0, Console(quiet=True), '')
    assert min(rate.values()) > 0
    assert order == ['a', 'b'] * (len(order) // 2)
    assert len(order) >= 6
    assert os.sched_getaffinity(0) == cores


def test_bench_names_its_benchmarks():
    """--list says one line each; an unknown name is one line and status 2."""
    command = [sys.executable, str(Path(references.__file__).parent)]
    listed = subprocess.run([*command, '--list'], capture_output=True, text=True, check=True)
    names = [line.split()[0] for line in listed.stdout.splitlines()]
    assert {'simulation', 'graph'} <= set(names)
    wrong = subprocess.run([*command, 'simulatoin'], capture_output=True, text=True, check=False)
    assert wrong.returncode == 2
    assert len(wrong.stderr.strip().splitlines()) == 1
