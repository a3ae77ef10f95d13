"""Mutations of the readers of mesh files."""

# ruff: noqa: E501
# fmt: off

from tests.mutations.mutation import Mutation

TEXT, OBJ, OFF, PLY, STL = (f"rtrace/scenes/meshes/{name}.py" for name in ("text", "obj", "off", "ply", "stl"))
GLTF, FILE, POLYGONS, MESH = "rtrace/scenes/meshes/gltf.py", "rtrace/scenes/meshes/gltf_file.py", "rtrace/scenes/meshes/polygons.py", "rtrace/scenes/mesh_file.py"
FILES, CORPUS = "tests/rtrace/scenes/test_mesh_files.py", "tests/rtrace/scenes/test_mesh_corpus.py"
BOTH = f"{FILES} {CORPUS}"

MUTATIONS = [
    Mutation("meshes: a comment may be continued", "rtrace/scenes/meshes/text.py", 'line = line[:-1] + b" " + _COMMENT.split(following, maxsplit=1)[0]', 'line = line[:-1] + b" " + following', BOTH),
    Mutation("meshes: #IND begins a comment", "rtrace/scenes/meshes/text.py", 'rb"(?<!1\\.)#|#(?![A-Z])"', 'rb"#"', FILES),
    Mutation("meshes: a comment needs a blank before it", "rtrace/scenes/meshes/text.py", 'rb"(?<!1\\.)#|#(?![A-Z])"', 'rb"(?<!\\S)#"', FILES),
    Mutation("meshes: UTF-16 without a mark is no text", "rtrace/scenes/meshes/text.py", "else _unmarked_coding(data[:64])", 'else ""', BOTH),
    Mutation("meshes: an infinite Microsoft number is NaN", "rtrace/scenes/meshes/text.py", "return np.inf if", "return np.nan if", f"{FILES} -k infinite"),
    Mutation("meshes: 1_000 is a number", "rtrace/scenes/meshes/text.py", 'return not self._signs[b"_"] or', "return True or", FILES),
    Mutation("meshes: lines counted from 0", "rtrace/scenes/meshes/text.py", "enumerate(self._lines, 1)", "enumerate(self._lines, 0)", FILES),
    Mutation("meshes: joined lines after names are not said", "rtrace/scenes/meshes/obj.py", "key in _NAMES and line in text.joined", "key in _NAMES and line < 0", FILES),
    Mutation("meshes: free-form surfaces are not said", "rtrace/scenes/meshes/obj.py", "elif key in _UNREAD:", "elif key in ():", FILES),
    Mutation("meshes: OBJ counts backwards from the end", "rtrace/scenes/meshes/obj.py", "np.searchsorted(np.array(vertex_lines, np.int64), np.array(face_lines, np.int64))", "np.full(len(face_lines), len(vertex_lines))", "tests/rtrace/scenes/test_scene.py -k backwards"),
    Mutation("meshes: OFF with other coordinates is read", "rtrace/scenes/meshes/off.py", 'if keyword[1] or b"nOFF" in words[0]:', "if keyword[1]:", FILES),
    Mutation("meshes: OFF's keyword in capitals only", OFF, "OFF(.*)\", re.IGNORECASE", "OFF(.*)\", 0", BOTH),
    Mutation("meshes: lines after the last OFF face are not said", "rtrace/scenes/meshes/off.py", "if n_rows > n_vertices + n_faces:", "if n_rows < 0:", FILES),
    Mutation("meshes: a binary PLY with CR loses a byte", "rtrace/scenes/meshes/ply.py", 'if first[0] == b"\\r" else', "if False else", f"{FILES} -k first_byte"),
    Mutation("meshes: end_header anywhere ends a PLY header", "rtrace/scenes/meshes/ply.py", 'if rows[-1] == [b"end_header"]:', 'if b"end_header" in rows[-1]:', BOTH),
    Mutation("meshes: more numbers than PLY promises", "rtrace/scenes/meshes/ply.py", 'if bytes(rest.rest).strip(b"\\0\\t\\n\\r \\x1a"):', "if False:", FILES),
    Mutation("meshes: PLY list lengths below 0", "rtrace/scenes/meshes/ply.py", "if not (0 <= length <", "if not (-9 <= length <", FILES),
    Mutation("meshes: PLY strips all turn one way", POLYGONS, "faces[1::2, :2] = faces[1::2, 1::-1]", "pass", CORPUS),
    Mutation("meshes: a strip goes on at -1", POLYGONS, "ends = np.flatnonzero(listed == -1)", "ends = np.flatnonzero(listed == -2)", FILES),
    Mutation("meshes: STL beginning with solid is text", "rtrace/scenes/meshes/stl.py", ' and b"\\0" not in text', "", BOTH),
    Mutation("meshes: STL bytes after the triangles are not said", "rtrace/scenes/meshes/stl.py", "elif promised < len(data):", "elif promised < 0:", FILES),
    Mutation("meshes: STL without a count is refused", "rtrace/scenes/meshes/stl.py", "_UNKNOWN = (0, 0xFFFFFFFF)", "_UNKNOWN = ()", BOTH),
    Mutation("meshes: STL's unended solid is not said", "rtrace/scenes/meshes/stl.py", "and may be truncated\"] if solid else []", "and may be truncated\"] if solid == b\"?\" else []", FILES),
    Mutation("meshes: STL 'end solid' is no end", "rtrace/scenes/meshes/stl.py", 'or (key == b"end" and', 'or (key == b"ende" and', FILES),
    Mutation("meshes: STL vertices outside of loops", "rtrace/scenes/meshes/stl.py", "            if not in_loop:\n", "            if False:\n", FILES),
    Mutation("meshes: polygons are always fans", POLYGONS, "for k in np.flatnonzero(wrong)]", "for k in np.flatnonzero(wrong & False)]", BOTH),
    Mutation("meshes: ears turn as they come", POLYGONS, "np.where((areas < 0)[:, None], ears[:, ::-1], ears)", "np.where((areas > 0)[:, None], ears[:, ::-1], ears)", BOTH),
    Mutation("meshes: ears are seen from behind", POLYGONS, "axes if normal[axis] > 0 else axes[::-1]", "axes", BOTH),
    Mutation("meshes: ears at the end", POLYGONS, 'faces = faces[np.argsort(owner, kind="stable")]', "pass", FILES),
    Mutation("meshes: polygons that cross themselves are not said", POLYGONS, "    if crossing:\n", "    if False:\n", FILES),
    Mutation("meshes: bent polygons are not said", POLYGONS, "    if bent.size:\n", "    if False:\n", FILES),
    Mutation("meshes: a bent polygon is measured by its corners' sum", POLYGONS, "_FLAT = 1e-3", "_FLAT = 1", FILES),
    Mutation("meshes: a bad corner spoils the ears", POLYGONS, "    if not usable.all():\n", "    if False:\n", FILES),
    Mutation("meshes: benchmark scenes are cut by ears", "rtrace/scenes/catalog.py", "return load_mesh(mesh, strict=strict, fans=True)", "return load_mesh(mesh, strict=strict)", f"{FILES} -k known"),
    Mutation("meshes: gzip is no mesh", MESH, 'data.startswith(b"\\x1f\\x8b\\x08")', 'data.startswith(b"\\x1f\\x8b\\x09")', BOTH),
    Mutation("meshes: glTF weights of the mesh alone", GLTF, '(node if "weights" in node else mesh).reals', "mesh.reals", CORPUS),
    Mutation("meshes: glTF morph targets at full weight", GLTF, "points + weight * moves", "points + moves", CORPUS),
    Mutation("meshes: glTF skins with the mesh's own place", GLTF, "places @ inverse[: len(places)].transpose(0, 2, 1)", "places", CORPUS),
    Mutation("meshes: glTF joints share the first weight", GLTF, "moved += weight[:, None] *", "moved += weights[:, :1] *", CORPUS),
    Mutation("meshes: glTF instances scaled before they are placed", GLTF, "place @ _compose(node.name", "_compose(node.name", CORPUS),
    Mutation("meshes: glTF hidden nodes are seen", GLTF, '.flag("visible", True)', '.flag("visible", True) and False', CORPUS),
    Mutation("meshes: glTF matrices row by row", GLTF, 'node.reals("matrix", 16).reshape(4, 4).T', 'node.reals("matrix", 16).reshape(4, 4)', CORPUS),
    Mutation("meshes: glTF parents do not count", GLTF, "own if parent is None else self._places[parent] @ own", "own", CORPUS),
    Mutation("meshes: glTF extensions that are needed", GLTF, "        if needed:\n", "        if False:\n", FILES),
    Mutation("meshes: glTF extensions that are not known are not said", GLTF, "if name not in (*_READ, DRACO) and", "if False and", FILES),
    Mutation("meshes: glTF children of two nodes", GLTF, "if child in self._parents or child == parent:", "if False:", FILES),
    Mutation("meshes: glTF nodes that stand twice in their scene", GLTF, "            if number in seen:\n", "            if number in found and number in self._parents:\n", FILES),
    Mutation("meshes: glTF sparse values are left out", FILE, "values[at] = self._view(", "self._view(", CORPUS),
    Mutation("meshes: glTF integers are not normalized", FILE, 'accessor.flag("normalized", False)', 'accessor.flag("normalised", False)', CORPUS),
    Mutation("meshes: glTF strides are the rows", FILE, 'view.number("byteStride", row) or row', "row", CORPUS),
    Mutation("meshes: glTF names stay encoded", FILE, "self._folder / unquote(uri)", "self._folder / uri", CORPUS),
    Mutation("meshes: glTF buffers that are cut off", FILE, "        if end > size:\n", "        if end > size + 99:\n", FILES),
    Mutation("meshes: GLB cut off", FILE, "if length > len(data):", "if length > 2 * len(data):", FILES),
    Mutation("meshes: numbers beyond all numbers print NumPy's warnings", "rtrace/scenes/mesh_file.py", 'np.errstate(all="ignore")', 'np.errstate()', "tests/rtrace/scenes/test_mesh_files.py"),
]
