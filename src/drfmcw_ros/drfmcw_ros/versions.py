"""What decides the bits of a stored result besides its settings: versions of libraries, digests of our code."""

import hashlib
import importlib.util
import platform
from importlib import metadata
from pathlib import Path

from drfmcw_physics.settings import ConfigurationError

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
