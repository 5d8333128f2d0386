"""Versions that stored results are marked with: they change with the code that makes the results, and only with it."""

import sys
import types
from pathlib import Path

import pytest

from drfmcw_physics.settings import ConfigurationError
from drfmcw_ros.commands.versions import release, running, versions


def test_digest_follows_the_code_while_the_process_runs(tmp_path, monkeypatch):
    """A proof that runs for an hour has to notice that its code was changed meanwhile."""
    monkeypatch.syspath_prepend(tmp_path)
    folder = tmp_path / 'some_package_of_ours'
    folder.mkdir()
    for name in ('__init__.py', 'model.py', 'report.py', 'notes.txt'):
        (folder / name).write_text('')
    packages, without = (folder.name,), ('report.py',)
    before = versions(packages, without)
    assert {'python', 'numpy', 'scipy', folder.name} == set(before)
    for name in ('report.py', 'notes.txt'):
        (folder / name).write_text('# changed')
    assert versions(packages, without) == before
    (folder / 'model.py').write_text('# changed')
    assert versions(packages, without) != before
    (folder / 'model.py').write_text('')
    (folder / 'model.py').rename(folder / 'models.py')
    assert versions(packages, without) != before


def test_unknown_package_is_named():
    with pytest.raises(ConfigurationError, match="package 'drfmcw_nothing' is not installed"):
        versions(('drfmcw_nothing',))


def test_a_process_states_its_release_and_the_packages_that_it_has_loaded(monkeypatch):
    """Modules that only bear such a name are none of ours, wherever they lie."""
    monkeypatch.setitem(sys.modules, 'drfmcw_of_a_user', types.ModuleType('drfmcw_of_a_user'))
    found = running()
    assert {'python', 'drfmcw_ros', 'drfmcw_physics'} <= set(found) and 'drfmcw_of_a_user' not in found
    assert 'drfmcw_msgs' not in found
    assert f'<version>{release()}</version>' in (Path(__file__).parents[1] / 'package.xml').read_text(encoding='utf-8')
