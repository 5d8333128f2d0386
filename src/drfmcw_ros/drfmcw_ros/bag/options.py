"""What command lines that read a recording share."""

import argparse
from collections.abc import Sequence
from typing import Any

from .files import SKIP_DAMAGED


class _SkipDamaged(argparse.Action):
    """Sets `SKIP_DAMAGED`, which every reader of this process and of its children sees."""

    def __call__(
        self,
        parser: argparse.ArgumentParser,
        namespace: argparse.Namespace,
        values: str | Sequence[Any] | None,
        option_string: str | None = None,
    ) -> None:
        """Take the option."""
        SKIP_DAMAGED.set(True)


def add_damage_option(parser: argparse.ArgumentParser) -> None:
    """Add `--skip-damaged` to the command line of what reads a recording."""
    text = 'read a damaged recording without its damaged parts, instead of refusing it'
    parser.add_argument('--skip-damaged', action=_SkipDamaged, nargs=0, help=text)
