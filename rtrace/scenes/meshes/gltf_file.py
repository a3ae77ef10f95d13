"""The container of glTF 2.0: .gltf or .glb with its buffers -> JSON items and arrays, every value checked where it is read."""

import base64
import binascii
import json
import re
import struct
from collections.abc import Iterator
from pathlib import Path
from typing import Any
from urllib.parse import unquote, unquote_to_bytes

import numpy as np

from rtrace.scenes.meshes.raw import MeshError, show
from rtrace.scenes.meshes.text import plain_text

_COMPONENTS: dict[int, np.dtype] = {5120: np.dtype("i1"), 5121: np.dtype("u1"), 5122: np.dtype("<i2"), 5123: np.dtype("<u2")}
_COMPONENTS |= {5125: np.dtype("<u4"), 5126: np.dtype("<f4")}
_N_COMPONENTS = {"SCALAR": 1, "VEC2": 2, "VEC3": 3, "VEC4": 4, "MAT4": 16}
#: An accessor without data stands for zeros; a damaged count must not fill the memory with them.
_MOST_ZEROS = 1 << 26


class Item:
    """One JSON object of the file; every value read is checked, and an error names it."""

    def __init__(self, value: Any, name: str) -> None:
        if not isinstance(value, dict):
            raise MeshError(f"{name} is {_brief(value)} and must be an object")
        self._value, self.name = value, name

    def __contains__(self, key: str) -> bool:
        return key in self._value

    def keys(self) -> list[str]:
        """Return the names of its members."""
        return list(self._value)

    def number(self, key: str, default: int | None = None) -> int:
        """Return a whole number from 0."""
        value = self._value.get(key, default)
        if isinstance(value, bool) or not isinstance(value, int | float) or not 0 <= value < 1 << 53 or value != int(value):
            raise MeshError(f"{self.name} has {key} {_brief(value)}; it must be a whole number from 0")
        return int(value)

    def text(self, key: str, default: str | None = None) -> str:
        """Return a string."""
        value = self._value.get(key, default)
        if not isinstance(value, str):
            raise MeshError(f"{self.name} has {key} {_brief(value)}; it must be a string")
        return value

    def flag(self, key: str, default: bool) -> bool:
        """Return a Boolean."""
        value = self._value.get(key, default)
        if not isinstance(value, bool):
            raise MeshError(f"{self.name} has {key} {_brief(value)}; it must be true or false")
        return value

    def item(self, key: str) -> "Item":
        """Return an object; an empty one if there is none."""
        return Item(self._value.get(key, {}), f"{key} of {self.name}")

    def items(self, key: str) -> list["Item"]:
        """Return a list of objects, named by their numbers; an empty one if there is none."""
        return [Item(value, f"{key.removesuffix('s')} {k} of {self.name}") for k, value in enumerate(self._list(key))]

    def numbers(self, key: str) -> list[int]:
        """Return a list of whole numbers from 0; an empty one if there is none."""
        return [Item({key: value}, self.name).number(key) for value in self._list(key)]

    def texts(self, key: str) -> list[str]:
        """Return a list of strings; an empty one if there is none."""
        return [Item({key: value}, self.name).text(key) for value in self._list(key)]

    def reals(self, key: str, n: int | None = None) -> np.ndarray:
        """Return a list of n numbers, or of any length, as float64."""
        values = self._list(key)
        are_numbers = all(isinstance(value, int | float) and not isinstance(value, bool) for value in values)
        if not are_numbers or n not in (None, len(values)):
            raise MeshError(f"{self.name} has {key} {_brief(values)}; it must be a list of {n or 'any'} numbers")
        return np.array([float(min(max(value, -1e300), 1e300)) for value in values], np.float64)

    def _list(self, key: str) -> list[Any]:
        value = self._value.get(key, [])
        if not isinstance(value, list):
            raise MeshError(f"{self.name} has {key} {_brief(value)}; it must be a list")
        return value


def _brief(value: Any) -> str:
    if isinstance(value, dict | list):
        return f"a{'n object' if isinstance(value, dict) else ' list'} of {len(value)}"
    text = json.dumps(value)
    return text if len(text) <= 40 else text[:37] + "..."


class GltfFile:
    """A glTF 2.0 file: ``root`` is its JSON; arrays are read on demand."""

    def __init__(self, data: bytes, path: Path) -> None:
        if path.name.lower().removesuffix(".gz").endswith(".glb") and not data.startswith((b"glTF", b"{")):
            raise MeshError(f"it begins with {show(data[:4])}, not with 'glTF'")
        text, self._chunk = _split_glb(data) if data.startswith(b"glTF") else (data, None)
        self.root = Item(_parse(text), "the file")
        self._folder = path.parent
        self._buffers: dict[int, bytes] = {}
        self._lists: dict[str, list[Item]] = {}
        asset = self.root.item("asset")
        version = asset.text("minVersion", asset.text("version", "1.0 (it names no version)"))
        if not version.startswith("2."):
            raise MeshError(f"it is glTF {version}; only 2.0 is read", "export glTF 2.0")

    def at(self, kind: str, number: int, user: str) -> Item:
        """Return the object of a kind ("nodes", "meshes", ...) that ``user`` names by its number."""
        if kind not in self._lists:
            self._lists[kind] = [Item(v, f"{_SINGULAR[kind]} {k}") for k, v in enumerate(self.root._list(kind))]
        if not number < len(self._lists[kind]):
            raise MeshError(f"{user} names {_SINGULAR[kind]} {number}; the file has {len(self._lists[kind])}")
        return self._lists[kind][number]

    def all(self, kind: str) -> Iterator[Item]:
        """Yield all objects of a kind."""
        for number in range(len(self.root._list(kind))):
            yield self.at(kind, number, "the file")

    def array(self, number: int, user: str, kind: str, integers: bool = False) -> np.ndarray:
        """Return an accessor's values, (count, components): float64, or the stored type with ``integers``.

        ``kind`` is its required type: SCALAR, VEC3, VEC4 or MAT4.
        """
        accessor = self.at("accessors", number, user)
        count, stored = accessor.number("count"), _COMPONENTS.get(accessor.number("componentType"))
        if accessor.text("type") != kind or stored is None or (integers and stored.kind != "u"):
            wanted = f"{kind} of unsigned integers" if integers else kind
            given = f"{accessor.text('type')} of component type {accessor.number('componentType')}"
            raise MeshError(f"{user} must be {wanted}, {accessor.name} is {given}")
        width = _N_COMPONENTS[kind]
        if "bufferView" in accessor:
            values = self._view(accessor, stored, count, width)
        elif count * width > _MOST_ZEROS:
            raise MeshError(f"{accessor.name} has {count:,} values and no bufferView")
        else:
            values = np.zeros((count, width), stored)
        if "sparse" in accessor:
            values = self._sparse(accessor.item("sparse"), values)
        if integers:
            return values
        if stored.kind != "f" and accessor.flag("normalized", False):
            return np.maximum(values / float(np.iinfo(stored).max), -1.0)
        return values.astype(np.float64)

    def _sparse(self, sparse: Item, values: np.ndarray) -> np.ndarray:
        count = sparse.number("count")
        where, what = sparse.item("indices"), sparse.item("values")
        stored = _COMPONENTS.get(where.number("componentType"))
        if stored is None or stored.kind != "u":
            raise MeshError(f"{where.name} has componentType {where.number('componentType')}; it must be unsigned")
        at = self._view(where, stored, count, 1)[:, 0]
        if at.size and at.max() >= len(values):
            raise MeshError(f"{where.name} has number {at.max()}; there are {len(values)} values")
        values = values.copy()
        values[at] = self._view(what, values.dtype, count, values.shape[1])
        return values

    def _view(self, user: Item, stored: np.dtype, count: int, width: int) -> np.ndarray:
        """Return (count, width) values from the bufferView that ``user`` names."""
        view = self.at("bufferViews", user.number("bufferView"), user.name)
        for name in view.item("extensions").keys():  # noqa: SIM118 - an Item is no dict
            if name.endswith("_meshopt_compression"):
                raise MeshError(f"{view.name} is compressed by {name}, which is not read", "export it without compression")
        data = self._buffer(view.number("buffer"), view.name)
        start, size = view.number("byteOffset", 0), view.number("byteLength")
        if start + size > len(data):
            raise MeshError(f"{view.name} ends at byte {start + size:,} of a buffer of {len(data):,}: it is truncated")
        row = width * stored.itemsize
        offset, stride = user.number("byteOffset", 0), view.number("byteStride", row) or row
        if stride < row:
            raise MeshError(f"{view.name} has byteStride {stride}; {user.name} has elements of {row} bytes")
        end = offset + stride * (count - 1) + row if count else 0
        if end > size:
            raise MeshError(f"{user.name} ends at byte {end:,} of {view.name}, which has {size:,}")
        if not count:
            return np.zeros((0, width), stored)
        strides = (stride, stored.itemsize)
        return np.ndarray((count, width), stored, data, start + offset, strides)

    def _buffer(self, number: int, user: str) -> bytes:
        if number not in self._buffers:
            buffer = self.at("buffers", number, user)
            if "uri" in buffer:
                data = self._load(buffer.text("uri"), buffer.name)
            elif number == 0 and self._chunk is not None:
                data = self._chunk
            else:
                raise MeshError(f"{buffer.name} has neither uri nor binary chunk")
            size = buffer.number("byteLength")
            if size > len(data):
                raise MeshError(f"{buffer.name} has {len(data):,} bytes of the {size:,} promised: it is truncated")
            self._buffers[number] = data[:size]
        return self._buffers[number]

    def _load(self, uri: str, name: str) -> bytes:
        """Return the bytes of a data: URI or of a file beside this one."""
        if uri[:5].lower() == "data:":
            head, comma, body = uri.partition(",")
            if not comma:
                raise MeshError(f"the data: URI of {name} has no comma")
            if not head.lower().endswith(";base64"):
                return unquote_to_bytes(body)
            try:
                return base64.b64decode(unquote_to_bytes(body), validate=True)
            except (binascii.Error, ValueError):
                raise MeshError(f"the data: URI of {name} is not base64") from None
        if re.match(r"[a-zA-Z][a-zA-Z0-9+.-]+:", uri):
            shown = show(uri.encode())
            raise MeshError(f"{name} is {shown}; only data: URIs and files beside it are read", "put the file beside it")
        beside = self._folder / unquote(uri)
        if not beside.is_file() and (self._folder / uri).is_file():  # a name without percent-encoding
            beside = self._folder / uri
        try:
            return beside.read_bytes()
        except FileNotFoundError:
            raise MeshError(f"the file {show(uri.encode())} of {name} is missing", "put it beside this one") from None
        except (OSError, ValueError) as error:  # a folder, no permission, a NUL in the name
            what = f"the file {show(uri.encode())} of {name} cannot be read"
            raise MeshError(f"{what} ({getattr(error, 'strerror', None) or error})", "put it beside this one") from None


_SINGULAR = {"nodes": "node", "meshes": "mesh", "scenes": "scene", "skins": "skin", "accessors": "accessor"}
_SINGULAR |= {"bufferViews": "bufferView", "buffers": "buffer"}


def _split_glb(data: bytes) -> tuple[bytes, bytes | None]:
    """Return the JSON chunk and the binary chunk of a GLB file."""
    if len(data) < 20:
        raise MeshError(f"it is truncated after {len(data)} bytes, within its header")
    version, length = struct.unpack("<II", data[4:12])
    if version != 2:
        raise MeshError(f"it is GLB version {version}; only 2 is read", "export glTF 2.0")
    if length > len(data):
        raise MeshError(f"its header promises {length:,} bytes, and it has {len(data):,}: it is truncated")
    chunks = []
    at = 12
    while at + 8 <= length:
        size, kind = struct.unpack("<I4s", data[at : at + 8])
        if at + 8 + size > length:
            raise MeshError(f"its chunk at byte {at} promises {size:,} bytes; {length - at - 8:,} are left: it is truncated")
        chunks.append((kind, data[at + 8 : at + 8 + size]))
        at += 8 + size
    if not chunks or chunks[0][0] != b"JSON":
        raise MeshError("its first chunk is not JSON")
    return chunks[0][1], next((chunk for kind, chunk in chunks[1:] if kind == b"BIN\0"), None)


def _parse(text: bytes) -> Any:
    try:
        return json.loads(plain_text(text).decode())
    except UnicodeDecodeError as error:
        raise MeshError(f"its JSON is not UTF-8 (byte {error.start})") from None
    except json.JSONDecodeError as error:
        raise MeshError(f"line {error.lineno}, column {error.colno}: it is not JSON ({error.msg})") from None
    except (RecursionError, ValueError):  # lists in lists in lists; a number of more than 4300 digits
        raise MeshError("its JSON is nested too deeply or has a number that is too long") from None
