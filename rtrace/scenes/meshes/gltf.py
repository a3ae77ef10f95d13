"""glTF 2.0 and GLB: the triangles of the default scene at rest, each in its place.

This reader exists because others in Python leave out parts of the format that change the shape: morph targets, skins,
instances, hidden nodes, sparse accessors, fans or quantized vertices.
"""

from pathlib import Path

import numpy as np

from rtrace.scenes.meshes.gltf_file import GltfFile, Item
from rtrace.scenes.meshes.polygons import fan, strips
from rtrace.scenes.meshes.raw import MeshError, RawMesh

INSTANCES, VISIBILITY, DRACO = "EXT_mesh_gpu_instancing", "KHR_node_visibility", "KHR_draco_mesh_compression"
MAX_VERTICES = 1 << 28
#: Extensions that are read or do not change the shape; any other that a file *requires* is refused.
_READ = (INSTANCES, VISIBILITY, "KHR_mesh_quantization")
_HARMLESS = ("KHR_materials_", "KHR_texture_", "KHR_lights_", "EXT_texture_", "KHR_xmp", "KHR_audio", "EXT_lights_")
#: Places where an unknown extension may change the shape, and known ones that do not.
_NO_SHAPE: tuple[str, ...] = ("EXT_mesh_features", "EXT_structural_metadata", "EXT_instance_features", "KHR_physics_")
_NO_SHAPE += (
    "KHR_node_selectability",
    "KHR_node_hoverability",
    "MSFT_lod",
    "CESIUM_primitive_outline",
    "VRM",
    "MOZ_",
    "OMI_",
    *_HARMLESS,
)


def read_gltf(data: bytes, path: Path) -> RawMesh:
    """Read the default scene of a .gltf or .glb file, distinguished by content. Raises MeshError."""
    reader = _Reader(GltfFile(data, path))
    for number in reader.in_scene():
        reader.add_node(number)
    if not reader.faces:
        raise MeshError("its scene has no mesh with triangles", "export a surface, not points or lines")
    faces = np.concatenate(reader.faces)
    return RawMesh(np.concatenate(reader.vertices), np.full(len(faces), 3), faces.ravel(), tuple(reader.notes))


class _Reader:
    """The nodes of a file, and the triangles collected so far."""

    def __init__(self, file: GltfFile) -> None:
        self.file = file
        self.vertices: list[np.ndarray] = []
        self.faces: list[np.ndarray] = []
        self.notes: list[str] = []
        self._count = 0
        self._places: dict[int, np.ndarray] = {}
        root = file.root
        needed = [n for n in root.texts("extensionsRequired") if n not in _READ and not n.startswith(_HARMLESS)]
        if needed:
            raise MeshError(f"it needs the extension {', '.join(needed)}, which is not read", "export it without")
        self._nodes = list(file.all("nodes"))
        self._parents: dict[int, int] = {}
        for parent, node in enumerate(self._nodes):
            for child in node.numbers("children"):
                file.at("nodes", child, node.name)
                if child in self._parents or child == parent:
                    raise MeshError(f"node {child} is the child of itself or of two nodes, which is not a tree")
                self._parents[child] = parent

    def in_scene(self) -> list[int]:
        """Return the numbers of the visible nodes of the default scene, parents before their children."""
        root = self.file.root
        scenes = list(self.file.all("scenes"))
        if scenes:
            number = root.number("scene", 0)
            todo = self.file.at("scenes", number, root.name).numbers("nodes")[::-1]
            if len(scenes) > 1:
                self.notes.append(f"it has {len(scenes)} scenes: number {number} is read")
        else:
            todo = [number for number in range(len(self._nodes)) if number not in self._parents][::-1]
        found: list[int] = []
        seen: set[int] = set()
        n_hidden = 0
        while todo:
            number = todo.pop()
            node = self.file.at("nodes", number, "its scene")
            if number in seen:
                raise MeshError(f"node {number} is in its scene twice, or within itself")
            seen.add(number)
            if not node.item("extensions").item(VISIBILITY).flag("visible", True):
                n_hidden += 1
                continue
            found.append(number)
            todo += node.numbers("children")[::-1]
        if n_hidden:
            self.notes.append(f"{n_hidden} hidden node{'s' if n_hidden > 1 else ''} ({VISIBILITY}) and what is below not read")
        return found

    def place(self, number: int) -> np.ndarray:
        """Return the matrix, (4, 4) float64, that moves a node's content to its place in the world."""
        chain: dict[int, None] = {}
        while number not in self._places:
            if number in chain:
                raise MeshError(f"node {number} is its own ancestor, which is not a tree")
            chain[number] = None
            if number not in self._parents:
                break
            number = self._parents[number]
        for each in reversed(chain):
            own = _matrix(self._nodes[each])
            parent = self._parents.get(each)
            self._places[each] = own if parent is None else self._places[parent] @ own
        return self._places[next(iter(chain), number)]

    def add_node(self, number: int) -> None:
        """Add the triangles of the mesh at a node."""
        node = self._nodes[number]
        self._look_for_unknown(node)
        if "mesh" not in node:
            return
        mesh = self.file.at("meshes", node.number("mesh"), node.name)
        self._look_for_unknown(mesh)
        weights = (node if "weights" in node else mesh).reals("weights")
        places = self._instances(node, self.place(number))
        joints = self._joints(node)
        if joints is not None and INSTANCES in node.item("extensions"):
            raise MeshError(f"{node.name} has both a skin and {INSTANCES}", "export it without one of them")
        for k, primitive in enumerate(mesh.items("primitives")):
            primitive.name = f"primitive {k} of {mesh.name}"
            self._look_for_unknown(primitive)
            faces = self._triangles(primitive)
            if faces is None:
                continue
            points = self._points(primitive, weights)
            if self._count + len(points) * len(places) > MAX_VERTICES:
                raise MeshError(f"with all its copies it has more than {MAX_VERTICES:,} vertices", "export fewer of them")
            if joints is not None and "JOINTS_0" in primitive.item("attributes"):
                placed = [self._skinned(primitive, points, joints)]
            else:
                placed = [points @ place[:3, :3].T + place[:3, 3] for place in places]
            for corners in placed:
                self.vertices.append(corners)
                # A vertex number beyond this mesh must not refer to the next one.
                self.faces.append(np.where(faces < len(corners), faces + self._count, -1))
                self._count += len(corners)

    def _look_for_unknown(self, item: Item) -> None:
        """Note each extension that may change the shape once."""
        for name in item.item("extensions").keys():  # noqa: SIM118 - an Item is no dict
            if name not in (*_READ, DRACO) and not name.startswith(_NO_SHAPE):
                note = f"the extension {name} ({item.name}, perhaps others) is not read and may change the shape"
                if not any(f" {name} " in said for said in self.notes):
                    self.notes.append(note)

    def _instances(self, node: Item, place: np.ndarray) -> list[np.ndarray]:
        """Return the places of a node's copies, or the node's place if it is not instanced."""
        if INSTANCES not in node.item("extensions"):
            return [place]
        attributes = node.item("extensions").item(INSTANCES).item("attributes")
        parts = {}
        for name, kind in (("TRANSLATION", "VEC3"), ("ROTATION", "VEC4"), ("SCALE", "VEC3")):
            if name in attributes:
                parts[name] = self.file.array(attributes.number(name), f"{name} of {node.name}", kind)
        counts = {len(part) for part in parts.values()}
        if len(counts) != 1:
            raise MeshError(f"{INSTANCES} of {node.name} has no attributes, or attributes of different counts")
        return [
            place @ _compose(node.name, *(parts[n][k] if n in parts else None for n in ("TRANSLATION", "ROTATION", "SCALE")))
            for k in range(counts.pop())
        ]

    def _joints(self, node: Item) -> np.ndarray | None:
        """Return the matrices, (n, 4, 4), that move the vertices of a skinned mesh into the world; None without a skin."""
        if "skin" not in node:
            return None
        skin = self.file.at("skins", node.number("skin"), node.name)
        numbers = skin.numbers("joints")
        for number in numbers:
            self.file.at("nodes", number, skin.name)
        places = np.array([self.place(number) for number in numbers]).reshape(-1, 4, 4)
        if "inverseBindMatrices" not in skin:
            return places
        inverse = self.file.array(skin.number("inverseBindMatrices"), skin.name, "MAT4").reshape(-1, 4, 4)
        if len(inverse) < len(places):
            raise MeshError(f"{skin.name} has {len(places)} joints and {len(inverse)} inverseBindMatrices")
        return places @ inverse[: len(places)].transpose(0, 2, 1)

    def _triangles(self, primitive: Item) -> np.ndarray | None:
        """Return the vertex numbers of a primitive's triangles, (n, 3); None for points and lines."""
        mode = primitive.number("mode", 4)
        attributes = primitive.item("attributes")
        if mode < 4 or "POSITION" not in attributes:
            return None
        if mode > 6:
            raise MeshError(f"{primitive.name} has mode {mode}; modes are 0 to 6")
        position = self.file.at("accessors", attributes.number("POSITION"), primitive.name)
        if DRACO in primitive.item("extensions") and "bufferView" not in position:
            raise MeshError(f"{primitive.name} is compressed by {DRACO}, which is not read", "export it without compression")
        if "indices" in primitive:
            user = f"indices of {primitive.name}"
            numbers = self.file.array(primitive.number("indices"), user, "SCALAR", integers=True)[:, 0].astype(np.int64)
        else:
            numbers = np.arange(position.number("count"), dtype=np.int64)
        n = np.array([len(numbers)])
        if mode == 4:
            if len(numbers) % 3:
                raise MeshError(f"{primitive.name} has {len(numbers)} vertex numbers, and triangles need three each")
            return numbers.reshape(-1, 3)
        return strips(n, numbers) if mode == 5 else fan(n, numbers)

    def _points(self, primitive: Item, weights: np.ndarray) -> np.ndarray:
        """Return a primitive's vertices, (n, 3) float64, with its morph targets at their weights at rest."""
        points = self.file.array(primitive.item("attributes").number("POSITION"), primitive.name, "VEC3")
        targets = primitive.items("targets")
        if len(weights) > len(targets):
            raise MeshError(f"{primitive.name} has {len(targets)} morph targets for {len(weights)} weights")
        for weight, target in zip(weights.tolist(), targets, strict=False):
            if weight and "POSITION" in target:
                moves = self.file.array(target.number("POSITION"), f"a target of {primitive.name}", "VEC3")
                if len(moves) != len(points):
                    raise MeshError(f"a target of {primitive.name} has {len(moves)} vertices, not {len(points)}")
                points = points + weight * moves
        return points

    def _skinned(self, primitive: Item, points: np.ndarray, joints: np.ndarray) -> np.ndarray:
        """Return vertices where their joints put them; the place of the mesh's node does not count."""
        attributes = primitive.item("attributes")
        moved, total, first = np.zeros((len(points), 3)), np.zeros(len(points)), None
        k = 0
        while f"JOINTS_{k}" in attributes:
            user = f"joints of {primitive.name}"
            numbers = self.file.array(attributes.number(f"JOINTS_{k}"), user, "VEC4", integers=True)
            weights = self.file.array(attributes.number(f"WEIGHTS_{k}"), user, "VEC4")
            if len(numbers) != len(points) or len(weights) != len(points):
                raise MeshError(f"{primitive.name} has {len(points)} vertices and other numbers of joints and weights")
            if numbers.size and numbers.max() >= len(joints):
                raise MeshError(f"{primitive.name} names joint {numbers.max()} of its skin, which has {len(joints)}")
            for number, weight in zip(numbers.T, weights.T, strict=True):
                own = joints[number]
                moved += weight[:, None] * (np.einsum("nij,nj->ni", own[:, :3, :3], points) + own[:, :3, 3])
                total += weight
            first = numbers[:, 0] if first is None else first
            k += 1
        unweighed = total == 0  # these follow their first joint
        if unweighed.any() and first is not None:
            own = joints[first[unweighed]]
            moved[unweighed] = np.einsum("nij,nj->ni", own[:, :3, :3], points[unweighed]) + own[:, :3, 3]
        return moved / np.where(unweighed, 1.0, total)[:, None]


def _matrix(node: Item) -> np.ndarray:
    """Return a node's local matrix, (4, 4) float64."""
    if "matrix" in node:
        return node.reals("matrix", 16).reshape(4, 4).T
    parts = [node.reals(key, n) if key in node else None for key, n in (("translation", 3), ("rotation", 4), ("scale", 3))]
    return _compose(node.name, *parts)


def _compose(name: str, move: np.ndarray | None, turn: np.ndarray | None, scale: np.ndarray | None) -> np.ndarray:
    """Return the matrix that scales, then turns (a quaternion x, y, z, w), then moves."""
    matrix = np.eye(4)
    if turn is not None:
        length = np.linalg.norm(turn)
        if not (np.isfinite(length) and length > 0):
            raise MeshError(f"{name} has a rotation that is not a quaternion: {turn.tolist()}")
        x, y, z, w = turn / length
        matrix[0, :3] = 1 - 2 * (y * y + z * z), 2 * (x * y - z * w), 2 * (x * z + y * w)
        matrix[1, :3] = 2 * (x * y + z * w), 1 - 2 * (x * x + z * z), 2 * (y * z - x * w)
        matrix[2, :3] = 2 * (x * z - y * w), 2 * (y * z + x * w), 1 - 2 * (x * x + y * y)
    if scale is not None:
        matrix[:3, :3] *= scale
    if move is not None:
        matrix[:3, 3] = move
    return matrix
