"""The catalogue of effects in the documentation, from their declarations (see drfmcw_ros.parameter_tables)."""

from drfmcw_physics.settings import declared_parameters

from .effects import Effect


def effect_table() -> str:
    """Return a Markdown table of all registered effects."""
    lines = ['| effect | of | parameters | what it is |', '|---|---|---|---|']
    for name, cls in sorted(Effect.registry.items()):
        parameters = ', '.join(
            f'`{parameter}` [{declared.unit}] {declared.description}'
            for parameter, (_, declared) in declared_parameters(cls).items()
        )
        lines.append(f'| `{name}` | {cls.of} | {parameters} | {" ".join(cls.__doc__.split())} |')
    return '\n'.join(lines)
