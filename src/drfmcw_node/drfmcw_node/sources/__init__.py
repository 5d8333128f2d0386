"""Where a station's sweeps come from besides its topic: one source per file, registered by its name.

In: what a digitiser sends, or a recording. Out: `Frame`, or `Sweep` with settings and calibrations, in order.
"""

import importlib
import pkgutil

for _module in pkgutil.iter_modules(__path__):
    importlib.import_module(f'{__name__}.{_module.name}')
