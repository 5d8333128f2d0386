"""Tables of the formats for the README, made from their declarations (drfmcw_ros.nodes.parameter_tables)."""

from drfmcw_physics.settings import declared_parameters
from drfmcw_ros.nodes.parameter_tables import parameter_table

from .formats.base import known_formats


def formats() -> str:
    """Return a Markdown table of all formats."""
    rows = ['| `format` | files | how it is read |', '| - | - | - |']
    for kind in known_formats().values():
        meaning = (kind.__doc__ or '').split('\n\n')[0].replace('\n', ' ')
        rows.append(f'| `{kind.name}` | {kind.title} | {meaning} |')
    return '\n'.join(rows)


def options() -> str:
    """Return the tables of all formats that have options, each behind the format's name."""
    parts = []
    for kind in known_formats().values():
        if declared_parameters(kind.options):
            parts.append(f'`{kind.name}`:\n\n{parameter_table(kind.options, at_run_time=False)}')
    return '\n\n'.join(parts)
