"""Types of arrays; what is in them and their shape stands in the docstrings."""

import numpy as np
import numpy.typing as npt

Array = npt.NDArray[np.float64]
Index = npt.NDArray[np.intp]
Mask = npt.NDArray[np.bool_]

# of no rows
NOWHERE: Index = np.zeros(0, np.intp)
