"""Versions that stored results are marked with: they change with the code that makes the results, and only with it."""

import pytest

from drfmcw_physics.settings import ConfigurationError
from drfmcw_ros.versions import versions


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
