"""Physical effects that the nominal model leaves out: one class per file, registered by its name.

Names and parameters are those of the interfaces' registry. A scenario switches effects on in its list `effects`.
"""

import importlib
import pkgutil

from .base import Effect, effect_from_mapping
from .recipe import WAVE, Recipe, geometric
from .traits import ActsOn, Motion, Of, Stage, Stated

for _module in pkgutil.iter_modules(__path__):
    importlib.import_module(f'{__name__}.{_module.name}')

__all__ = ['WAVE', 'ActsOn', 'Effect', 'Motion', 'Of', 'Recipe', 'Stage', 'Stated', 'effect_from_mapping', 'geometric']
