"""Mutations of what reads runs and traces: checks of values, streams, line ends, names."""

# ruff: noqa: E501
# fmt: off

from tests.mutations.mutation import Mutation

VALUES, STREAMS, DIN = "tests/traces/test_run_values.py", "tests/traces/test_stream.py", "tests/traces/test_din.py"
CH, RD, ST, DI = "traces/validation.py", "traces/reader.py", "traces/stream.py", "traces/din.py"

MUTATIONS = [
    # Traces of addresses in CSV and Parquet
    Mutation("address files: types are ignored", "traces/address_files.py", "return table[as_array(numbers.indices)]", "return np.zeros(len(values), np.uint8)", "tests/traces/test_address_files.py"),
    Mutation("address files: a row's last byte may be beyond 2^32", "traces/address_files.py", "(address > (1 << 32) - size)", "(address > 1 << 32)", "tests/traces/test_address_files.py"),
    Mutation("address files: rows are numbered anew in each piece", "traces/address_files.py", "yield self._checked(table, n)", "yield self._checked(table, 0)", "tests/traces/test_address_files.py"),
    Mutation("address files: the last line without an end is lost", "traces/address_files.py", "        if rest.strip():\n", "        if rest.endswith(b'\\n'):\n", "tests/traces/test_address_files.py"),
    Mutation("address files: only a name tells", "traces/address_files.py", 'return head.startswith(_PARQUET) or "address" in', 'return False and "address" in', "tests/traces/test_address_files.py"),
    Mutation("stream: the first bytes of a pipe are taken", ST, "            head, self._head = self._head, None\n            if self._start is not None:\n                self._file.seek(self._start)\n                head = None\n", "            head = None\n            if self._start is not None:\n                self._file.seek(self._start)\n", "tests/traces/test_address_files.py"),
    Mutation("address files: exported prefetches are reads", "traces/address_files.py", '0x{address:x},{kind:x},', '0x{address:x},0,', "tests/traces/test_address_files.py"),
    # --- values ---
    Mutation("values: nulls are not seen", CH, "    if column.null_count:", "    if column.null_count < 0:", VALUES),
    Mutation("values: any kind will do", CH, "kinds[i] > PREFETCH or not (allowed[node] >> kinds[i]) & np.uint8(1)", "not (allowed[node] >> (kinds[i] & 3)) & np.uint8(1)", VALUES),
    Mutation("values: a node one beyond the tree's", CH, "if node >= n or kinds", "if node > n or kinds", "tests/traces/test_access_check.py"),
    Mutation("values: nodes with children may be entered as leaves", "traces/validation.py", "INNER_KINDS = READ, PUSH, PREFETCH", "INNER_KINDS = READ, PUSH, LEAF, PREFETCH", VALUES),
    Mutation("values: a kd-tree's leaf may be missed", "traces/validation.py", "(READ,) if node_format.boxes == OWN_BOX else ()", "(READ,) if node_format.boxes <= OWN_BOX else ()", VALUES),
    Mutation("values: a node may be its own parent", CH, "np.uint64(up) >= i", "np.uint64(up) > i", VALUES),
    Mutation("values: siblings of two parents", CH, "if parent[i + np.uint64(1)] != up:", "if parent[i + np.uint64(1)] < 0:", VALUES),
    Mutation("values: two pairs of one parent", CH, "if has_children[above]:", "if has_children[above] and up < 0:", VALUES),
    Mutation("values: the upper sibling's level is not looked at", CH, "if level[i + np.uint64(1)] != wanted:", "if level[i] != wanted:", VALUES),
    Mutation("values: the root may have any level", CH, "if level[0] != 0:", "if level[0] < 0:", VALUES),
    Mutation("values: axis 4 is a leaf's", CH, "if axis[i] > LEAF_AXIS or (axis[i] == LEAF_AXIS) == has_children[i]:", "if (axis[i] >= LEAF_AXIS) == has_children[i]:", VALUES),
    Mutation("values: triangles in inner nodes", CH, "if has_children[i] and n_prims[i] != 0:", "if has_children[i] and n_prims[i] > 9:", VALUES),
    Mutation("values: numbers of nodes are not looked at", CH, "if node[i] != i:", "if node[i] != node[i]:", VALUES),
    Mutation("values: addresses are not looked at", CH, 'if rule == _OK and "address" in columns:', "if False:", VALUES),
    Mutation("values: the tree of a layout as stored is not checked", "traces/run.py", 'self.columns("nodes", ["axis"])["axis"] if', 'self._plain("nodes", ["axis"])["axis"] if', VALUES),
    Mutation("values: a quick look finds every node good", CH, "    is_bad = False\n    for i in range(np.uint64(node.size)):", "    is_bad = False\n    for i in range(0):", VALUES),
    Mutation("values: a quick look does not compare kinds", CH, " and bits_of_kinds <= last_kind", "", "tests/traces/test_access_check.py"),
    Mutation("values: a quick look lets a node one beyond by", CH, "return highest <= last and", "return highest <= last + 1 and", "tests/traces/test_access_check.py"),
    Mutation("values: a quick look lets every kind by", CH, "is_allowed &= np.uint64(allowed[", "is_allowed |= np.uint64(allowed[", "tests/traces/test_access_check.py"),
    Mutation("values: rows count from the batch", "traces/run.py", "            row += read.num_rows\n", "", VALUES),
    Mutation("values: the walk's rows count from the batch", "cachesim/prefetch.py", "        self._n_rows += nodes.size\n", "        self._n_rows += 1\n", "tests/cachesim/test_prefetch.py"),
    Mutation("values: a BVH discards what it popped", "cachesim/prefetch.py", "sp = np.int64(0) if boxes == OWN_BOX else sp - 1", "sp -= 1", "tests/cachesim/test_prefetch.py tests/test_fuzz.py"),
    Mutation("values: other types are refused", CH, "return inner == wanted or pa.types.is_integer(inner) or pa.types.is_floating(inner)", "return inner == wanted", VALUES),
    Mutation("values: texts are numbers", CH, "or pa.types.is_floating(inner)\n", "or pa.types.is_floating(inner) or pa.types.is_string(inner)\n", VALUES),
    Mutation("values: one of two columns is taken", RD, "if len(columns) != 1:", "if not columns:", VALUES),
    Mutation("values: rays overlap", CH, "first != ends - count", "first > ends", VALUES),
    Mutation("values: the last ray's accesses are not counted", CH, "if n and int(ends[-1]) != footer.n_accesses:", "if n and int(ends[-1]) > footer.n_accesses:", VALUES),
    Mutation("values: layouts take two pairs of one parent", "cachesim/layout.py", ".max() > 1:", ".max() > 2:", VALUES),
    # --- streams ---
    Mutation("streams: the head is lost", ST, "_HeadFirst(head, self._file)", '_HeadFirst(b"", self._file)', STREAMS),
    Mutation("streams: pipes are read twice", ST, "if n_passes > 1 and self._start is None:", "if n_passes > 2 and self._start is None:", STREAMS),
    Mutation("streams: the second pass goes on where the first ended", ST, "                self._file.seek(self._start)\n", "                pass\n", f"{STREAMS} {DIN}"),
    Mutation("streams: gzip by its name", ST, 'b"\\x1f\\x8b": "gzip"', 'b"\\x1f\\x8c": "gzip"', STREAMS),
    Mutation("streams: marks of packed files before records", ST, "            if not plain(head):", "            if head:", STREAMS),
    Mutation("streams: short reads end a chunk", ST, "while missing and (piece := file.read(missing)):", "while missing == n_bytes and (piece := file.read(missing)):", STREAMS + " -k byte_by_byte"),
    Mutation("streams: a damaged pack is its end", ST, "            if packing:\n                raise", "            if packing:\n                return\n                raise", STREAMS),
    Mutation("streams: CR is a blank", DI, '.replace(b"\\r", b"\\n")\n', '.replace(b"\\r", b" ")\n', STREAMS),
    Mutation("streams: CR LF cut by a chunk is two ends", DI, 'chunk, held = chunk[:-1], b"\\r"', "pass", STREAMS),
    Mutation("streams: UTF-16 without a mark is binary", DI, 'enumerate(("utf-16-le", "utf-16-be"))', "enumerate(())", STREAMS),
    Mutation("streams: the mark of UTF-8 stays", DI, "chunk.removeprefix(codecs.BOM_UTF8)", "chunk", STREAMS),
    Mutation("din: records past 2^32 are read", DI, "> np.uint64(1 << 32):", "> np.uint64(1 << 33):", DIN),
    Mutation("din: a record that ends at 2^32 is refused", DI, "> np.uint64(1 << 32):", ">= np.uint64(1 << 32):", DIN),
    Mutation("din: a label may not have 0x", DI, "        if text[i] != 10:\n            if text[i] == 48 and (text[i + 1] == 120 or text[i + 1] == 88):\n                i += 2\n", "        if text[i] != 10:\n", f"{DIN} {STREAMS}"),
    Mutation("din: no warning of prefetches that span lines", DI, 'if fmt == "binary" and prefetch == "b":', 'if fmt == "xml":', STREAMS),
    # --- names and forms ---
    Mutation("names: handed to Arrow", RD, "handles.enter_context(opened(file))", "str(file)", STREAMS),
    Mutation("names: written by Arrow", "traces/writer.py", 'pa.OSFile(os.fsencode(path), "wb")', 'pa.OSFile(str(path), "wb")', STREAMS),
    Mutation("names: printed as they are", "nptrace/groups.py", 'sys.stdout.reconfigure(errors="backslashreplace")', "pass", STREAMS + " -k escapes"),
    Mutation("forms: --json beside another form", "nptrace/output.py", 'if as_json and form not in (None, "json"):', 'if as_json and form == "json":', STREAMS),
]
