"""What decides the bits of a result besides its settings: versions of libraries, digests of our code."""

import hashlib
import importlib.util
import platform
import sys
import xml.etree.ElementTree as ElementTree
from importlib import metadata
from pathlib import Path

from ament_index_python.packages import PackageNotFoundError, get_package_share_directory

from drfmcw_physics.settings import ConfigurationError

SOFTWARE = 'Software'
"""Diagnostic task that every node has: its message is the release, its values are versions and digests of the code."""

_OURS = 'drfmcw_'
_GENERATED = 'drfmcw_msgs'
_LIBRARIES = ('numpy', 'scipy')


def versions(packages: tuple[str, ...], without: tuple[str, ...] = ()) -> dict[str, str]:
    """Return versions of Python and the numerical libraries, and a digest of each package's code as it is now.

    Args:
        packages: names.
        without: names of their files that decide nothing, such as 'report.py'.

    Raises:
        ConfigurationError: a package is not installed.
    """
    found = {'python': platform.python_version()} | {name: metadata.version(name) for name in _LIBRARIES}
    for package in packages:
        spec = importlib.util.find_spec(package)
        if spec is None or spec.origin is None:
            raise ConfigurationError(f"package '{package}' is not installed")
        folder = Path(spec.origin).parent
        digest = hashlib.sha256()
        for path in sorted(folder.rglob('*.py')):
            if path.name not in without:
                digest.update(f'{path.relative_to(folder)}\n'.encode() + path.read_bytes())
        found[package] = digest.hexdigest()[:16]
    return found


def release() -> str:
    """Return the version of drfmcw as its package.xml has it, 'unknown' where it is not installed."""
    try:
        description = Path(get_package_share_directory(__name__.partition('.')[0])) / 'package.xml'
        return str(ElementTree.parse(description).findtext('version'))
    except (PackageNotFoundError, OSError, ElementTree.ParseError):
        return 'unknown'


def running() -> dict[str, str]:
    """Return `versions` of the packages of drfmcw that this process has loaded."""
    loaded = {
        name
        for name, module in tuple(sys.modules.items())
        if name.startswith(_OURS) and '.' not in name and getattr(module, '__path__', None) and module.__file__
    }
    return versions(tuple(sorted(loaded - {_GENERATED})))
