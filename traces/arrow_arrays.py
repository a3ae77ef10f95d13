"""Columns of Arrow -> NumPy arrays that are views of the same memory."""

import numpy as np
import pyarrow as pa


def as_array(column: pa.Array | pa.ChunkedArray) -> np.ndarray:
    """Return a column of numbers without nulls as a read-only array, of the column's own memory if it is one chunk.

    ``Array.to_numpy`` does the same, and imports pandas where that is installed: a third of the time that a command takes to
    start.
    """
    if isinstance(column, pa.ChunkedArray):
        column = column.chunk(0) if column.num_chunks == 1 else column.combine_chunks()
    dtype = np.dtype(column.type.to_pandas_dtype())
    if not len(column):
        values = np.empty(0, dtype)
    else:
        values = np.frombuffer(column.buffers()[1], dtype, len(column), column.offset * dtype.itemsize)
    values.flags.writeable = False  # also where Arrow allows it: Numba would compile separate code for such arrays
    return values
