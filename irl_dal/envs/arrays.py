"""The array types that the city's modules share."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

__all__ = ["Array", "Colour", "Image", "Info", "Observation"]

Array = NDArray[np.float64]
Image = NDArray[np.uint8]
Colour = tuple[float, float, float]  # RGB in [0, 1]
Observation = dict[str, NDArray[Any]]
Info = dict[str, Any]
