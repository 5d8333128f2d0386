"""Where the YAML files of sites and scenarios are."""

from pathlib import Path

from ament_index_python.packages import PackageNotFoundError, get_package_share_directory

from drfmcw_physics.settings import ConfigurationError, nearest

_CHECKOUT = Path(__file__).resolve().parents[4] / 'config'  # where this file lies in a checkout
_PACKAGE = 'drfmcw_bringup'  # installs them


def find_config(name: str, folder: str = '') -> Path:
    """Return the file that `name` means: a path, or the name of a file in config/ with or without .yaml.

    Args:
        name: as a user gives it.
        folder: of config/ in which names are looked up, such as 'hardware' for parameter files of real stations.

    Raises:
        ConfigurationError: there is none; the nearest name is given.
    """
    if Path(name).is_file():
        return Path(name)
    folders = [_CHECKOUT]
    try:
        folders.append(Path(get_package_share_directory(_PACKAGE), 'config'))
    except PackageNotFoundError:  # only the packages below it are installed
        pass
    known = {path.stem: path for place in reversed(folders) for path in (place / folder).glob('*.yaml')}
    stem = Path(name).stem if name.endswith('.yaml') else name
    if '/' not in name and stem in known:
        return known[stem]
    where = Path('config', folder)
    raise ConfigurationError(f'{name}: no such file, and none of that name in {where}/{nearest(stem, sorted(known))}')
