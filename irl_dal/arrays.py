"""The types that the packages' modules share."""

from typing import Any

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
Colour = tuple[float, float, float]  # RGB in [0, 1]
Observation = dict[str, NDArray[Any]]
Info = dict[str, Any]
