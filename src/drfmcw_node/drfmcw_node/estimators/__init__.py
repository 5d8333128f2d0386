"""How a station estimates a beat frequency from the samples of a sweep: one estimator per file, registered by its name.

In: samples of sweeps (arrays), the sweep's settings, calibrations. Out: `Estimates`; nothing here knows ROS.
"""

import importlib
import pkgutil

for _module in pkgutil.iter_modules(__path__):
    importlib.import_module(f'{__name__}.{_module.name}')
