"""The contract between the stages: what a run on disk is. ``writer`` and ``reader`` follow it; all three know neither stage.

A run is one directory with four files (``traces/README.md`` describes every column):

    accesses.parquet   one row per node access, in the order the hardware would issue them
    rays.parquet       one row per ray, in the order they were shot
    nodes.parquet      one row per tree node
    image.png          the picture that was traced

Node *numbers* are stored, not addresses: the address is chosen at replay. The footer of each Parquet file has the same
text under the key ``nptrace`` (``footer.py``), without a time stamp, so the same command gives the same bytes.
"""

import os
from typing import Any

import pyarrow as pa

from nptrace_base.errors import NptraceError

#: The newest version. A run has the oldest one that describes it, so that programs that know that one read it.
FORMAT_VERSION = 3
ROW_GROUP = 1 << 18  # rows: a page, which is one column of them, is 2 MB at most
METADATA_KEY = b"nptrace"

#: The kinds of an access. 0-2 are the demand stream (the paper's configuration A); with 3 it is configuration B.
READ, PUSH, LEAF, PREFETCH = range(4)

#: The types of a ray.
PRIMARY, SHADOW = range(2)


def _field(name: str, type_: pa.DataType, meaning: str) -> pa.Field:
    return pa.field(name, type_, nullable=False, metadata={"meaning": meaning})


#: The meanings are bytes of every run, which must not change: hence the hyphens.
ACCESSES = pa.schema(
    [
        _field("ray", pa.uint32(), "number of the ray, ascending"),
        _field("node", pa.uint32(), "number of the node read or requested"),
        _field("kind", pa.uint8(), "0 read; 1 read, one child pushed; 2 leaf entered; 3 pre-fetch request"),
    ]
)
RAYS = pa.schema(
    [
        _field("ray", pa.uint32(), "number of the ray: its row"),
        _field("x", pa.uint16(), "pixel column, 0 at the left"),
        _field("y", pa.uint16(), "pixel row, 0 at the top"),
        _field("type", pa.uint8(), "0 primary; 1 shadow"),
        _field("first", pa.uint64(), "row of its first access in accesses.parquet"),
        _field("count", pa.uint32(), "number of its accesses, pre-fetches included"),
        _field("prim", pa.int32(), "triangle hit (shadow: the occluder found), -1 for none"),
        _field("t", pa.float32(), "ray parameter of the hit, infinity for none"),
    ]
)
NODES = pa.schema(
    [
        _field("node", pa.uint32(), "number of the node: its row"),
        _field("parent", pa.int32(), "number of its parent, -1 for the root"),
        _field("level", pa.uint16(), "steps from the root"),
        _field("axis", pa.uint8(), "split axis 0, 1, 2; 3 for a leaf"),
        _field("n_prims", pa.uint32(), "triangles in the leaf; 0 for an inner node or an empty leaf"),
        _field("address", pa.uint64(), "byte address as stored: node number x node size"),
    ]
)
#: In place of ``address`` above where leaves are no nodes in memory.
INNER_ADDRESS = _field("address", pa.uint64(), "byte address of an inner node as stored; 2^64 - 1 for a leaf")
SPLIT = [_field("split", pa.float32(), "kd-tree: position of the split plane; NaN for a leaf")]
BOX = [_field(f"{end}_{axis}", pa.float32(), "BVH: the node's box") for axis in "xyz" for end in ("min", "max")]

FILES = ("accesses.parquet", "rays.parquet", "nodes.parquet", "image.png")

# Measured: neighbouring rays repeat whole paths, which zstd finds in plain numbers if a page is long enough, and which a
# dictionary or a delta would hide from it; the usual 20,000 rows a page took twice the bytes. All other columns are
# written faster than plain with their bytes split, and most are smaller; differences took longer.
ENCODING: dict[str, Any] = {
    "compression": "zstd",
    "compression_level": 1,
    "use_dictionary": False,
    "data_page_size": 1 << 22,
    "max_rows_per_page": ROW_GROUP,
    "write_batch_size": 1 << 16,
    "write_page_checksum": True,
}


def column_encoding(schema: pa.Schema) -> dict[str, str]:
    """Return the columns whose bytes are split: all except the two that zstd compresses better unsplit."""
    return {name: "BYTE_STREAM_SPLIT" for name in schema.names if schema is not ACCESSES or name == "kind"}


def printable(name: str) -> str:
    """Return a file's name as UTF-8 text; other bytes appear as ``\\xef``."""
    return os.fsencode(name).decode("utf-8", "backslashreplace")


class RunError(NptraceError):
    """A directory that is not a readable run; the message states the problem and the way out."""
