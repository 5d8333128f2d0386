"""The README's parameter tables, from the declarations: ``python -m drfmcw_node.parameter_tables README.md``."""

import dataclasses
import sys
import typing
from pathlib import Path

from drfmcw_physics.oscillators import Calibration
from drfmcw_physics.settings import declared_parameters
from drfmcw_physics.sweep import SweepSettings

from .estimation import EstimatorSettings
from .station_settings import StationSettings

_TABLES = {
    'station': (StationSettings, ''),
    'estimation': (EstimatorSettings, ''),
    'sweep': (SweepSettings, 'sweep.'),
    'calibration': (Calibration, 'calibration.'),
}


def table(name: str) -> str:
    """Return one of the tables as Markdown."""
    cls, prefix = _TABLES[name]
    hints = typing.get_type_hints(cls)
    lines = ['| parameter | default | unit | range | while running | meaning |', '|---|---|---|---|---|---|']
    for field_name, (field, declared) in declared_parameters(cls).items():
        default = field.default if field.default is not dataclasses.MISSING else 'required'
        shown = f'`{default!r}`' if hints[field_name] in (str, bool) else f'{default:.10g}'
        low, high = declared.bounds
        if declared.choices:
            valid = ', '.join(f'`{c}`' for c in declared.choices)
        elif hints[field_name] in (int, float) and high < float('inf'):
            valid = f'{low:g} ... {high:g}'
        else:
            valid = ''
        meaning = declared.description + (f'; NaN: {declared.nan_means}' if declared.nan_means else '')
        unit = '' if declared.unit == '1' else declared.unit
        fixed = 'fixed' if declared.structural else 'yes'
        lines.append(f'| `{prefix}{field_name}` | {shown} | {unit} | {valid} | {fixed} | {meaning} |')
    return '\n'.join(lines)


def filled(text: str) -> str:
    """Return `text` with the tables between its markers renewed."""
    for name in _TABLES:
        begin, end = f'<!-- table {name} -->', f'<!-- end {name} -->'
        before, rest = text.split(begin, 1)
        text = f'{before}{begin}\n{table(name)}\n{end}{rest.split(end, 1)[1]}'
    return text


if __name__ == '__main__':
    path = Path(sys.argv[1])
    path.write_text(filled(path.read_text(encoding='utf-8')), encoding='utf-8')
