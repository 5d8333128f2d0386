"""`repair RECORDING`: make a complete recording of one whose end is missing, or whose parts are damaged."""

import fcntl
import sys
from collections.abc import Sequence
from pathlib import Path

from drfmcw_physics.settings import ConfigurationError

from ..commands.cli import Parser, guarded
from .files import BagError, BagReader, BagWriter
from .options import add_damage_option
from .storage.reading import SUFFIXES


def repair(path: Path, out: Path | None, storage: str = 'mcap') -> tuple[Path, int]:
    """Copy what is whole of a recording into a new one.

    Without `out`, the new one takes the recording's name, and the old one is kept as NAME.unrepaired. Nothing is
    removed.

    Args:
        path: of the recording.
        out: directory to create; None for the recording's own, or beside a single storage file.
        storage: format of the new recording.

    Returns:
        (path, number of messages) of the new recording.

    Raises:
        ConfigurationError: it is being recorded, cannot be read, or the new one cannot be written.
    """
    kept = path.with_name(f'{path.name}.unrepaired')
    in_place = out is None and path.is_dir()
    if in_place and kept.exists():
        raise ConfigurationError(f'{kept}: exists already, from an earlier repair; name another with --out')
    if out is None:
        out = path.with_name(f'.{path.name}.repaired') if in_place else _beside(path)
    if path.exists():
        _refuse_while_recording(path)
    name = path.name if in_place else None
    with BagReader(path) as bag, BagWriter(out, storage, overwrite=in_place, name=name) as writer:
        for connection in bag.connections:
            writer.add_recorded(connection)
        types = bag.topics
        for topic, time, raw in bag.stored_messages(types.keys()):
            writer.write(topic, types[topic], time, raw)
    if in_place:
        path.rename(kept)
        out.rename(path)
        out = path
    return out, writer.message_count


def _beside(path: Path) -> Path:
    """Return the directory that a repaired storage file gets."""
    suffix = next((s for s in sorted(SUFFIXES, key=len, reverse=True) if path.name.endswith(s)), '')
    return path.with_name(path.name.removesuffix(suffix) or path.name) if suffix else path.with_name(f'{path.name}_new')


def _refuse_while_recording(path: Path) -> None:
    """Raise BagError where a recorder holds the lock of a storage file."""
    for file in path.iterdir() if path.is_dir() else [path]:
        if file.name.endswith(SUFFIXES):
            with open(file, 'rb') as held:
                try:
                    fcntl.flock(held, fcntl.LOCK_EX | fcntl.LOCK_NB)
                except BlockingIOError:
                    raise BagError(f'{file}: is being recorded') from None


def main(argv: Sequence[str] | None = None) -> int:
    """Run the command line; return the exit status."""
    parser = Parser(prog='drfmcw repair', description=__doc__)
    parser.add_argument('recording', type=Path, help='rosbag2 recording: directory or storage file')
    parser.add_argument('--out', type=Path, metavar='RECORDING', help='directory to create (in place of the recording)')
    add_damage_option(parser)
    arguments = parser.parse_args(argv)

    def work() -> None:
        path, count = repair(arguments.recording, arguments.out)
        print(f'{path}: {count} messages')

    return guarded('drfmcw repair', work)


if __name__ == '__main__':
    sys.exit(main())
