"""Tables in Markdown files, from the declarations: ``python -m drfmcw_ros.nodes.parameter_tables README.md ...``.

A table stands between two comments, the first of which says what it is made from::

    <!-- parameters drfmcw_fusion.settings:FusionSettings -->   ROS parameters, one per field of a settings class
    <!-- parameters drfmcw_physics.rules.mode:ModeSettings mode. -->  the same, with a prefix
    <!-- keys drfmcw_sim.scenario:TimingSettings -->            keys of a YAML section
    <!-- made drfmcw_sim.effect_table:effect_table -->          whatever a function returns
    <!-- end -->
"""

import dataclasses
import functools
import importlib
import math
import re
import sys
import typing
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from drfmcw_physics.settings import ConfigurationError, Parameter, declared_parameters

from ..commands.cli import Parser, guarded, write_atomically

_TABLE = re.compile(r'(<!-- (parameters|keys|made) ([\w.]+):(\w+)(?: ([\w.]+))? -->\n)(.*?)(<!-- end -->)', re.DOTALL)


def parameter_table(cls: type, prefix: str = '', at_run_time: bool = True) -> str:
    """Return a Markdown table of the declared fields of a settings class.

    Args:
        cls: frozen dataclass whose fields were made with settings.parameter.
        prefix: put before each name.
        at_run_time: say which can be changed while a node runs.
    """
    titles = ['parameter' if at_run_time else 'key', 'default', 'unit', 'range']
    titles += ['while running', 'meaning'] if at_run_time else ['meaning']
    rows = [titles, ['-'] * len(titles)]
    hints = typing.get_type_hints(cls)
    for name, (field, declared) in declared_parameters(cls).items():
        unit = '' if declared.unit == '1' else declared.unit
        row = [f'`{prefix}{name}`', _default(field), unit, _valid(hints[name], declared)]
        if at_run_time:
            row.append('fixed' if declared.structural else 'yes')
        meaning = declared.description + (f'; NaN: {declared.nan_means}' if declared.nan_means else '')
        rows.append([*row, meaning.replace('<', r'\<')])
    return '\n'.join(f'| {" | ".join(row)} |' for row in rows)


def _default(field: dataclasses.Field) -> str:
    if field.default is not dataclasses.MISSING:
        return _shown(field.default)
    if field.default_factory is not dataclasses.MISSING:
        return _shown(field.default_factory())
    return 'required'


def _shown(value: Any) -> str:
    if isinstance(value, bool):
        return f'`{str(value).lower()}`'
    if isinstance(value, float) and math.isnan(value):
        return 'NaN'
    if isinstance(value, (int, float)):
        return f'{value:.10g}'
    if isinstance(value, list):
        return ', '.join(map(_shown, value)) or 'empty'
    if isinstance(value, str):
        return f'`{value}`' if value else 'empty'
    return str(value)


def _valid(kind: Any, declared: Parameter) -> str:
    if declared.choices:
        return ', '.join(f'`{choice}`' for choice in declared.choices)
    low, high = declared.bounds
    return f'{low:g} ... {high:g}' if kind is not bool and high < math.inf else ''


def _content(kind: str, module: str, name: str, prefix: str) -> str:
    source = getattr(importlib.import_module(module), name)
    return source() if kind == 'made' else parameter_table(source, prefix, at_run_time=kind == 'parameters')


def filled(text: str) -> str:
    """Return `text` with the tables between its comments renewed."""

    def renew(match: re.Match) -> str:
        begin, kind, module, name, prefix, _, end = match.groups(default='')
        return f'{begin}{_content(kind, module, name, prefix)}\n{end}'

    return _TABLE.sub(renew, text)


def main(argv: Sequence[str] | None = None) -> int:
    """Renew the tables of the files named; return the exit status."""
    parser = Parser(
        prog='parameter_tables', description='Renew the tables in Markdown files that are made from declarations.'
    )
    parser.add_argument('files', nargs='+', type=Path, metavar='FILE', help='Markdown files')
    return guarded('parameter_tables', functools.partial(_renew, parser.parse_args(argv).files))


def _renew(files: Sequence[Path]) -> None:
    for path in files:
        try:
            text = path.read_text(encoding='utf-8')
        except OSError as error:
            raise ConfigurationError(f'{path}: {error.strerror}') from None
        write_atomically(path, filled(text))


if __name__ == '__main__':
    sys.exit(main())
