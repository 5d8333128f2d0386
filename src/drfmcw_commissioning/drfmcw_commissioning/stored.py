"""`calibrate list, show, diff, rollback, store`: calibrations that this machine keeps; `push`: to a running station."""

import argparse
import dataclasses
import math
import os
from collections.abc import Iterator
from typing import Any

from rich.console import Console
from rich.table import Table

from drfmcw_physics.settings import ConfigurationError, read_text
from drfmcw_ros.calibration.document import Document, read_document
from drfmcw_ros.calibration.service import store_on_station
from drfmcw_ros.calibration.store import CalibrationStore, state_directory

_LONGEST_WAIT = 3600.0  # [s]
_HIDDEN = ('version', 'date', 'operator')  # of a difference: each version has its own


def add_parsers(commands: Any) -> None:
    """Add the subcommands."""
    for name, summary, work in (
        ('list', 'list the stored calibrations', _list),
        ('show', 'print a stored calibration', _show),
        ('diff', 'list what differs between two versions', _diff),
        ('rollback', 'store an earlier version again, as the newest', _rollback),
        ('store', 'store the document of a file', _store),
    ):
        parser = commands.add_parser(name, help=summary, description=summary)
        parser.add_argument('--state', default='', metavar='DIR', help='state directory (the one of this user)')
        parser.set_defaults(work=work)
        if name == 'store':
            parser.add_argument('file', help='calibration document')
        else:
            parser.add_argument('station', nargs='?' if name == 'list' else None, help='name of the station')
        if name in ('rollback', 'store'):
            parser.add_argument('--operator', default='', metavar='NAME', help='who stores it')
        if name == 'show':
            parser.add_argument('--version', type=int, metavar='N', help='version (the newest)')
        elif name == 'diff':
            parser.add_argument('versions', type=int, nargs='*', metavar='VERSION', help='one or two (the newest two)')
        elif name == 'rollback':
            parser.add_argument('--version', type=int, metavar='N', help='version to return to (the one before)')
    _add_push(commands)


def _add_push(commands: Any) -> None:
    summary = 'store the document of a file on a running station, which uses it at once'
    parser = commands.add_parser('push', help=summary, description=summary)
    parser.set_defaults(work=_push)
    parser.add_argument('station', help='name of the station')
    parser.add_argument('file', help='calibration document')
    parser.add_argument('--operator', default='', metavar='NAME', help='who stores it')
    parser.add_argument('--timeout', type=float, default=10.0, metavar='S', help='longest wait for the answer (10)')


def store_of(arguments: argparse.Namespace) -> CalibrationStore:
    """Return the store that a command line means."""
    return CalibrationStore(state_directory(os.environ, arguments.state))


def _list(arguments: argparse.Namespace) -> None:
    store = store_of(arguments)
    stations = [arguments.station] if arguments.station else store.stations()
    if not any(store.versions(name) for name in stations):
        of = f" of '{arguments.station}'" if arguments.station else ''
        print(f'no calibration{of} is stored in {store.directory}')
        return
    table = Table(box=None, pad_edge=False, header_style='bold')
    for title in ('station', 'version', 'date', 'operator', 'instrument', 'note'):
        table.add_column(title)
    for name in stations:
        for version in store.versions(name):
            try:
                d = store.read(name, version)
                table.add_row(name, str(version), d.date, d.operator, d.instrument, d.note)
            except ConfigurationError as error:
                table.add_row(name, str(version), '', '', '', f'unreadable: {error}')
    Console().print(table, highlight=False, markup=False)


def _show(arguments: argparse.Namespace) -> None:
    print(store_of(arguments).read(arguments.station, arguments.version).text(), end='')


def _diff(arguments: argparse.Namespace) -> None:
    store = store_of(arguments)
    versions = arguments.versions
    if len(versions) > 2:
        raise ConfigurationError(f'{len(versions)} versions are given; two can be compared')
    stored = store.versions(arguments.station)
    if len(versions) < 2:
        new = stored[-1] if stored else None
        old = versions[0] if versions else (stored[-2] if len(stored) > 1 else None)
        if old is None or new is None:
            raise ConfigurationError(
                f"'{arguments.station}' has {len(stored)} stored calibrations; two can be compared"
            )
        versions = [old, new]
    one, other = (store.read(arguments.station, version) for version in versions)
    lines = list(differences(one, other))
    print(f'{arguments.station}: version {versions[0]} -> {versions[1]}')
    print('\n'.join(f'  {line}' for line in lines) if lines else '  no difference')


def differences(one: Document, other: Document) -> Iterator[str]:
    """Yield one line per value that differs."""
    before, after = dict(_values(one)), dict(_values(other))
    for name in [*before, *(name for name in after if name not in before)]:
        old, new = before.get(name), after.get(name)
        if old == new or name in _HIDDEN:
            continue
        change = ''
        if isinstance(old, float) and isinstance(new, float) and math.isfinite(new - old):
            change = f' ({new - old:+.4g})'
        yield f'{name}: {_text(old)} -> {_text(new)}{change}'


def _values(document: Document) -> Iterator[tuple[str, Any]]:
    for section, content in dataclasses.asdict(document).items():
        if not isinstance(content, dict):
            yield section, content
            continue
        for key, value in content.items():
            if value not in ([], '') and not (isinstance(value, float) and math.isnan(value)):
                yield f'{section}.{key}', value


def _text(value: Any) -> str:
    if value is None:
        return 'not stated'
    if isinstance(value, list):
        return '[' + ', '.join(_text(v) for v in value) + ']'
    return f'{value:.12g}' if isinstance(value, float) else str(value) or 'empty'


def _rollback(arguments: argparse.Namespace) -> None:
    store = store_of(arguments)
    versions = store.versions(arguments.station)
    if arguments.version is None and len(versions) < 2:
        raise ConfigurationError(f"'{arguments.station}' has no version before the newest")
    version = versions[-2] if arguments.version is None else arguments.version
    document = store.read(arguments.station, version)
    note = f'version {version} again' + (f': {document.note}' if document.note else '')
    stored = store.add(dataclasses.replace(document, note=note), arguments.operator)
    print(f'{arguments.station}: version {version} is stored again as version {stored.version}')


def _store(arguments: argparse.Namespace) -> None:
    stored = store_of(arguments).add(read_document(arguments.file), arguments.operator)
    print(f'{stored.station}: stored as version {stored.version}')


def _push(arguments: argparse.Namespace) -> None:
    if not 0.0 < arguments.timeout <= _LONGEST_WAIT:
        raise ConfigurationError(f'--timeout = {arguments.timeout:g} s is not within 0 ... {_LONGEST_WAIT:g}')
    version = store_on_station(arguments.station, read_text(arguments.file), arguments.operator, arguments.timeout)
    print(f'{arguments.station}: accepted, stored there as version {version}')
