"""Arrow's columns as arrays: views of the same memory, read-only, for every type of the contract."""

import numpy as np
import pyarrow as pa
import pytest

from traces.arrow_arrays import as_array
from traces.run import FIELDS

TYPES = sorted(
    {str(field.type) for table in FIELDS.values() for field in table.values() if not pa.types.is_nested(field.type)}
)


@pytest.mark.parametrize("name", TYPES)
@pytest.mark.parametrize("n_chunks", [0, 1, 3])
@pytest.mark.parametrize("start", [0, 2])
def test_the_values_of_a_column(name, n_chunks, start):
    values = np.arange(7).astype(pa.type_for_alias(name).to_pandas_dtype())
    column = pa.chunked_array([pa.array(values)] * n_chunks, pa.type_for_alias(name)).slice(start)
    array = as_array(column)
    assert array.dtype == values.dtype and not array.flags.writeable
    np.testing.assert_array_equal(array, np.tile(values, n_chunks)[start:])


def test_the_memory_is_shared():
    values = np.arange(10, dtype=np.uint32)
    assert np.shares_memory(as_array(pa.array(values)[3:]), values)
