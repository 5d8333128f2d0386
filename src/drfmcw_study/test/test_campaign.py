"""The campaign: the same rows whoever does the work, and one line where something is wrong."""

import pytest
from dask_clusters import dask_cluster

from drfmcw_study.campaign.command import main

QUICK = ['--quick', '--seed', '5', '--fault', 'PLL unlocked', '--out']


def rows(directory):
    return {path.name: path.read_bytes() for path in directory.iterdir()}


def test_processes_and_a_cluster_give_the_same_rows_and_resume(tmp_path, capsys):
    assert main([*QUICK, str(tmp_path / 'here'), '--jobs', '2']) == 0
    table = capsys.readouterr().out
    with dask_cluster(tmp_path) as (address, _):
        assert main([*QUICK, str(tmp_path / 'there'), '--scheduler', address]) == 0
    assert capsys.readouterr().out == table
    assert rows(tmp_path / 'there') == rows(tmp_path / 'here') != {}
    assert main([*QUICK, str(tmp_path / 'there'), '--scheduler', address]) == 0  # nothing is left to do for it
    assert capsys.readouterr().out == table


@pytest.mark.parametrize('address', ['localhost', 'tcp://127.0.0.1:1'])
def test_no_scheduler_is_one_line(tmp_path, capsys, address):
    assert main([*QUICK, str(tmp_path / 'out'), '--scheduler', address]) == 2
    error = capsys.readouterr().err
    assert error.startswith(f'drfmcw campaign: --scheduler {address}: ') and error.count('\n') == 1
