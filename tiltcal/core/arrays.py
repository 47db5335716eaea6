"""Types of arrays; what is in them and their shape stands in the docstrings."""

from typing import TypeVar

import numpy as np
import numpy.typing as npt

Array = npt.NDArray[np.float64]
Single = npt.NDArray[np.float32]
Index = npt.NDArray[np.intp]
Mask = npt.NDArray[np.bool_]
Real = TypeVar("Real", Array, Single)

# of no rows
NOWHERE: Index = np.zeros(0, np.intp)
