"""The effects of the interface, and others outside its registry, as changes of a `generator.Scene`.

Units of parameters are the interface's, also where they are not SI.
"""

from collections.abc import Sequence

from ..generator.model import FIRST, SECOND, Scene
from .kinds import KINDS, Applied
from .outside import OUTSIDE
from .registered import REGISTERED

__all__ = ['KINDS', 'OUTSIDE', 'REGISTERED', 'Applied', 'conceal']


def conceal(scene: Scene, effects: Sequence[Applied]) -> Scene:
    """Put effects into a scene, changing it, and return it.

    Raises:
        ValueError: no such effect, station or parameter.
    """
    for applied in effects:
        if applied.effect not in KINDS:
            raise ValueError(f"no effect '{applied.effect}'")
        kind, names = KINDS[applied.effect], scene.condition.names
        unknown = set(applied.parameters) - set(kind.units)
        if unknown:
            raise ValueError(f'{applied.effect}: no parameter {sorted(unknown)}')
        if applied.station is None:
            stations: tuple[int, ...] = (FIRST, SECOND)
        elif kind.of == 'station' and applied.station in names:
            stations = (names.index(applied.station),)
        else:
            raise ValueError(f"{applied.effect}: no station '{applied.station}'")
        kind.apply(scene, stations, applied.parameters)
    return scene
