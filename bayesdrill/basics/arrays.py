"""Define array types by the type of their elements: floats, flags, indices and counts."""

from __future__ import annotations

from typing import Annotated, Any

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
Flags = NDArray[np.bool_]
Indices = NDArray[np.intp]
Counts = NDArray[np.int64]

PART = 1 << 18  # largest number of samples that are processed at once, to limit the memory


class _Stored:
    """The annotation tells pydantic to read a list, or a list of lists, as an array of floats."""

    @classmethod
    def __get_pydantic_core_schema__(cls, *_: Any) -> Any:
        from pydantic_core import core_schema

        numbers = core_schema.list_schema(core_schema.float_schema())
        table = core_schema.union_schema([numbers, core_schema.list_schema(numbers)])
        return core_schema.no_info_after_validator_function(np.array, table)


StoredArray = Annotated[Array, _Stored]  # an array in a dataclass that is written as JSON
