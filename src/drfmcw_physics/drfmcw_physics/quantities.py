"""What the physical functions take: one value, or an array whose values are taken one by one.

They return the same: a scalar for scalars, else an array of the arguments' broadcast shape.
"""

from typing import TypeAlias

import numpy as np

Quantity: TypeAlias = float | np.ndarray
"""One value or an array of values, in the unit that the function states."""
