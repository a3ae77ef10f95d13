"""Mutations of what is reported: printed values, units and names, orders, pictures, borders, state between batches."""

# ruff: noqa: E501
# fmt: off

from tests.mutations.mutation import Mutation

PRINTED, CHECKS = "tests/nptrace/test_printed_values.py", "tests/nptrace/test_check.py"
BORDERS, ORDERS, PICTURES = "tests/rtrace/test_borders.py", "tests/rtrace/test_orders.py", "tests/rtrace/test_pictures.py"
STATE, TREES = "tests/cachesim/test_state_between_batches.py", "tests/rtrace/trees/test_tree_cache.py"
RENDERED, REPLAYED, SWEPT = PRINTED + " -k test_render", PRINTED + " -k test_replay", PRINTED + " -k test_sweep"
FITTED, IDENTITY, NAMED = "tests/nptrace_base/test_tables.py", "tests/traces/test_identity.py", "tests/nptrace/test_run_names.py"
CLOCKED = "tests/nptrace/test_clock_commands.py"
CURVES, BARS, KNEES = "tests/cachesim/report/test_curves.py", "tests/cachesim/report/test_bars.py", "tests/cachesim/test_knees.py"
VIEWED, BY_PIXEL = "tests/nptrace/test_view.py", "tests/cachesim/clock/test_by_pixel.py"
PLOTTED = PRINTED + " -k plot"
TABLE1, BLOCK, EXPORTED = PRINTED + " -k test_table1", PRINTED + " -k dinero", PRINTED + " -k test_export"

VERDICTS = "tests/cachesim/report/test_verdicts.py"
REPORTED = "tests/nptrace/test_report.py"

MUTATIONS = [
    # The page of npcache report
    Mutation("page: the levels are of another cache", "nptrace/commands/report.py", "configs[:1], policies, layouts, \"level\"", "configs[-1:], policies, layouts, \"level\"", REPORTED + " -k the_numbers_are"),
    Mutation("page: the clock's numbers are not in its command", "nptrace/commands/report.py", "--machine {machine}{given}{_cache_options([first])}", "--machine {machine}{_cache_options([first])}", REPORTED + " -k the_numbers_are"),
    Mutation("page: JSON can end its element", "cachesim/report/page.py", '.replace("<", "\\\\u003c")', '.replace("\\0", "")', REPORTED + " -k names_that_are_html"),
    Mutation("page: a large map shows the first pixel of a square", "cachesim/report/page.py", "np.add.reduceat(np.add.reduceat(values, rows, axis=0), columns, axis=1)", "values[::side, ::side]", REPORTED + " -k large_map"),
    Mutation("page: maps go from bottom to top", "cachesim/report/page.py", "np.ascontiguousarray(cells, dtype", "np.ascontiguousarray(cells[::-1], dtype", REPORTED + " -k heat_maps"),
    Mutation("page: a missing package is found after the work", "nptrace/commands/report.py", "    check_page(path)\n", "", REPORTED + " -k missing_packages"),
    Mutation("page: a row of a table is of another run", "cachesim/report/page.py", "return {\"text\": _text(row[key], form), \"order\": row[key]}", "return {\"text\": _text(row[key], form), \"order\": _text(row[key], form)}", REPORTED + " -k tables_have"),
    # verdicts
    Mutation("verdict: p per access of any kind", "cachesim/report/replay_tables.py", "p = [each.prefetch_accesses / each.demand_accesses for", "p = [each.prefetch_accesses / (each.demand_accesses + each.prefetch_accesses) for", VERDICTS),
    Mutation("verdict: 1 / (1 + p) subtracted instead of multiplied", "cachesim/report/replay_tables.py", "ratio / (1 + extra) for ratio", "ratio - 1 / (1 + extra) for ratio", VERDICTS),
    Mutation("verdict: bytes count fills alone", "cachesim/report/replay_tables.py", "traffic = [each.bytes_from_memory / (", "traffic = [each.prefetch_misses * each.config.line_bytes / (", VERDICTS),
    # Borders
    Mutation("border: a batch longer than a chunk is cut", "rtrace/render.py",
             "step = batch * (most // batch)", "step = most", BORDERS + " -k never_cut"),
    Mutation("border: a chunk holds one batch too few and ends inside it", "rtrace/render.py",
             "step = batch * (most // batch)", "step = max(batch, most - 1)", BORDERS + " -k never_cut"),
    Mutation("border: shadow rays of a batch longer than a chunk come first", "rtrace/render.py", "for which in (PRIMARY, SHADOW):", "for which in (SHADOW, PRIMARY):", BORDERS + " -k never_cut"),
    Mutation("border: first in 32 bits", "rtrace/counts.py", '+= np.uint64(self.n_accesses)', '+= np.uint64(self.n_accesses & 0xFFFFFFFF)', BORDERS + " -k 32_bits"),
    Mutation("border: rays of later chunks numbered from 0", "rtrace/counts.py", 'chunk.rays["ray"] += np.uint32(self.n_rays)', 'chunk.rays["ray"] += np.uint32(0)', BORDERS + " -k 32_bits"),
    Mutation("border: lines of nodes from addresses of 32 bits", "cachesim/lines.py",
             "first, last = address >> shift,", "first, last = (address & 0xFFFFFFFF) >> shift,", BORDERS + " -k 2_32"),
    Mutation("border: the last line of a node from an address of 32 bits", "cachesim/lines.py",
             "(address + (node_bytes - 1)) >> shift", "((address + (node_bytes - 1)) & 0xFFFFFFFF) >> shift", BORDERS + " -k 2_32"),
    Mutation("border: addresses of text with 31 bits", "traces/din.py", "address[n] = value & np.uint64(0xFFFFFFFC)", "address[n] = value & np.uint64(0x7FFFFFFC)", BORDERS + " -k last_addresses"),
    Mutation("border: DineroIV's block counts in float32", "cachesim/report/dinero.py", "return np.array([fetch + read", "return np.float32([fetch + read", BORDERS + " -k whole"),
    Mutation("border: misses counted in float32", "cachesim/fast_lru.py", "misses=np.zeros(N_ACCESS_TYPES, np.int64)", "misses=np.zeros(N_ACCESS_TYPES, np.float32)", BORDERS + " -k more_misses"),
    Mutation("border: a sweep counts in int16", "cachesim/all_associativity.py", "counts=np.zeros(n_exponents * 2 * n_depths, np.int64)", "counts=np.zeros(n_exponents * 2 * n_depths, np.int16)", BORDERS + " -k more_misses"),
    Mutation("border: the prefetch unit's stack ends at 64", "cachesim/policies/machine.py",
             "depth = max(int(tree.level.max()), 1)", "depth = min(max(int(tree.level.max()), 1), 64)", BORDERS + " -k deeper"),
    Mutation("border: nodes below level 63 are on level 63", "rtrace/trees/tree.py", "level[i] + np.uint16(1)", "min(level[i] + np.uint16(1), np.uint16(63))", BORDERS + " -k deeper"),
    # Pictures
    Mutation("picture: no shadows", "rtrace/shading.py", "lit[owner[k]] = 0", "lit[owner[k]] = 1", PICTURES + " -k shaded"),
    Mutation("picture: all facing surfaces in shadow", "rtrace/shading.py", "if occluder[k] >= 0:\n            lit", "if occluder[k] >= -1:\n            lit", PICTURES + " -k shaded"),
    Mutation("picture: chunks of the shadow pass not drawn", "rtrace/render.py", "            if chunk.is_shaded:", "            if chunk.is_shaded and chunk.n_shadow < len(chunk.rays['ray']):", PICTURES + " -k beyond"),
    Mutation("picture: pixels in shooting order", "rtrace/render.py", "picture[chunk.pixels] = chunk.colours", "picture[np.sort(chunk.pixels)] = chunk.colours", PICTURES + " -k every_order"),
    Mutation("picture: half the light", "rtrace/shading.py", "0.74 * facing[i]", "0.37 * facing[i]", PICTURES + " -k shaded"),
    Mutation("picture: red and blue swapped", "rtrace/shading.py", "colours[i, k] = np.uint8(", "colours[i, 2 - k] = np.uint8(", PICTURES + " -k shaded"),
    Mutation("shadow offset: a quarter", "rtrace/shading.py", "OFFSET = 2.0 * 2.0**-22", "OFFSET = 0.5 * 2.0**-22", PICTURES + " -k units"),
    Mutation("shadow offset: 256 times", "rtrace/shading.py", "off = OFFSET * size", "off = 256.0 * OFFSET * size", PICTURES + " -k units"),
    Mutation("shadow offset: twice before the light", "rtrace/shading.py", "last = 1.0 - OFFSET * max", "last = 1.0 - 2.0 * OFFSET * max", PICTURES + " -k units"),
    # Orders
    Mutation("order: Morton turned", "rtrace/camera.py", "_curve(((0, 0), (1, 0), (0, 1), (1, 1)), (0, 0, 0, 0)", "_curve(((0, 0), (0, 1), (1, 0), (1, 1)), (0, 0, 0, 0)", ORDERS),
    Mutation("order: Hilbert turned", "rtrace/camera.py", "_curve(((0, 0), (0, 1), (1, 1), (1, 0)), (1, 0, 0, 3)", "_curve(((0, 0), (1, 0), (1, 1), (0, 1)), (1, 0, 0, 3)", ORDERS),
    Mutation("order: the quarters of Hilbert's curve not turned", "rtrace/camera.py", "(1, 0, 0, 3), width", "(0, 0, 0, 0), width", ORDERS),
    Mutation("order: tiles row by row", "rtrace/camera.py", "split.transpose(3, 0, 1, 4, 2, 5)", "split.transpose(0, 3, 1, 4, 2, 5)", ORDERS),
    Mutation("order: squares column by column", "rtrace/camera.py", "split.transpose(3, 0, 1, 4, 2, 5)", "split.transpose(3, 0, 4, 1, 2, 5)", ORDERS),
    Mutation("order: another half of the random bits", "rtrace/camera.py", "& np.uint64(0xFFFFFFFF_00000000)", "<< np.uint64(32)", ORDERS),
    Mutation("order: random from the seed 0", "rtrace/camera.py", "np.random.PCG64(seed)", "np.random.PCG64(0)", ORDERS),
    Mutation("order: --seed of render ignored", "nptrace/scene_options.py", "self.order, self.batch, self.seed)", "self.order, self.batch, 0)", PRINTED + " -k random_order"),
    # render
    Mutation("render: n_shadowed counts primary hits", "rtrace/counts.py", "n_shadowed += chunk.n_shadowed", "n_shadowed += chunk.n_hits", RENDERED),
    Mutation("render: n_hits and n_shadow_rays swapped", "rtrace/render.py", "counts.n_hits, counts.n_shadow, counts.n_shadowed,", "counts.n_shadow, counts.n_hits, counts.n_shadowed,", RENDERED),
    Mutation("render: prefetches count as accesses", "rtrace/render.py", "counts.n_accesses - counts.n_prefetches - n_leaves", "counts.n_accesses - n_leaves", RENDERED),
    Mutation("render: bytes without the picture's", "rtrace/render.py", "for file in path.iterdir())", "for file in path.glob('*.parquet'))", RENDERED),
    Mutation("render: hits as a share of all rays", "rtrace/render.py", "n = self.n_rays - self.n_shadow_rays", "n = self.n_rays", RENDERED),
    Mutation("render: shadowed as a share of the hits", "rtrace/render.py", "self.n_shadowed / self.n_shadow_rays if", "self.n_shadowed / self.n_hits if", RENDERED),
    Mutation("render: accesses per primary ray", "rtrace/render.py", "return self.n_accesses / self.n_rays", "return self.n_accesses / (self.n_rays - self.n_shadow_rays)", RENDERED),
    Mutation("render: columns of nodes and triangles swapped in the table", "nptrace/commands/render.py", "number(run.n_triangles), number(run.n_nodes)", "number(run.n_nodes), number(run.n_triangles)", RENDERED),
    Mutation("render: prefetches in the column of accesses", "nptrace/commands/render.py", "number(run.n_accesses), number(run.accesses_per_ray, 1)", "number(run.n_prefetches), number(run.accesses_per_ray, 1)", RENDERED),
    # replay
    Mutation("replay: KB of 1000 bytes", "cachesim/report/replay_tables.py", "r.bytes_from_memory / 1024", "r.bytes_from_memory / 1000", REPLAYED),
    Mutation("replay: useful and useless swapped in the JSON", "cachesim/result.py", '"useful": self.useful,\n            "useless": self.useless', '"useful": self.useless,\n            "useless": self.useful', REPLAYED),
    Mutation("replay: useless and resident swapped in the table", "cachesim/report/replay_tables.py", "(r.useful, r.useless, r.resident)", "(r.useful, r.resident, r.useless)", REPLAYED),
    Mutation("replay: capacity and conflict swapped in the table", "cachesim/report/replay_tables.py", "(r.compulsory, r.capacity, r.conflict)", "(r.compulsory, r.conflict, r.capacity)", REPLAYED),
    Mutation("replay: kinds of misses with those of prefetches", "cachesim/result.py", "int(getattr(self, name)[:PREFETCH].sum())", "int(getattr(self, name).sum())", REPLAYED),
    Mutation("replay: redundant counts the fills", "cachesim/result.py", '"redundant": self.prefetch_accesses - self.prefetch_misses', '"redundant": self.prefetch_misses', REPLAYED),
    Mutation("replay: accuracy of those issued", "cachesim/result.py", "return ratio(self.useful, self.prefetch_misses)", "return ratio(self.useful, self.prefetch_accesses)", REPLAYED),
    Mutation("replay: the paper's rate of demand accesses alone", "cachesim/result.py", "self.demand_accesses + self.prefetch_accesses)", "self.demand_accesses)", REPLAYED),
    Mutation("replay: traffic of demand misses alone", "cachesim/result.py", "return ratio(self.bytes_from_memory, self", "return ratio(self.demand_misses * self.config.line_bytes, self", REPLAYED),
    Mutation("replay: rates of the table swapped", "cachesim/report/replay_tables.py", "[percent(r.demand_miss_rate), percent(r.paper_miss_rate)]", "[percent(r.paper_miss_rate), percent(r.demand_miss_rate)]", REPLAYED),
    Mutation("replay: sizes of lines and ways swapped in the JSON", "cachesim/result.py", '"ways": config.ways,\n            "line_bytes": config.line_bytes', '"ways": config.line_bytes,\n            "line_bytes": config.ways', REPLAYED),
    Mutation("replay: --seed ignored", "nptrace/options.py", "self.policy, self.seed)", "self.policy, 0)", PRINTED + " -k random_policy"),
    Mutation("replay: per cent of a share of one", "nptrace_base/tables.py", "None if value is None else 100 * value, decimals", "None if value is None else value, decimals", REPLAYED),
    # DineroIV's block
    Mutation("dinero: columns of misc and ifetch swapped", "cachesim/report/dinero.py", "[fetch + read + write + misc, fetch, read + write + misc, read, write, misc]", "[fetch + read + write + misc, misc, read + write + misc, read, write, fetch]", BLOCK),
    Mutation("dinero: fractions of the prefetches of all", "cachesim/report/dinero.py", "requests / _or_one(requests[0])", "requests / _or_one(total[0])", BLOCK),
    Mutation("dinero: PF miss rate of all accesses", "cachesim/report/dinero.py", "request_misses / _or_one(requests)", "request_misses / _or_one(total)", BLOCK),
    Mutation("dinero: kinds of the prefetches' misses from demand", "cachesim/report/dinero.py", '_three_c(result, PREFETCH, request_misses, "PF {}", "fract")', '_three_c(result, 0, request_misses, "PF {}", "fract")', BLOCK),
    Mutation("dinero: bytes of demand misses alone", "cachesim/report/dinero.py", 'f" Bytes From Memory\\t{result.bytes_from_memory:12.0f}', 'f" Bytes From Memory\\t{result.demand_misses * 16:12.0f}', BLOCK),
    # sweep
    Mutation("sweep: coverage is what remains", "cachesim/sweep.py", '"coverage": None if coverage is None else 1.0 - coverage', '"coverage": coverage', SWEPT),
    Mutation("sweep: total misses without prefetches", "cachesim/sweep.py", '"total_misses": misses', '"total_misses": self.demand_misses', SWEPT),
    Mutation("sweep: sets and ways swapped", "cachesim/sweep.py", '"sets": config.n_sets,\n            "ways": config.ways', '"sets": config.ways,\n            "ways": config.n_sets', SWEPT),
    Mutation("sweep: miss rate without over all accesses", "cachesim/sweep.py", "ratio(self.demand_misses_without, self.demand_accesses)", "ratio(self.demand_misses_without, self.demand_accesses + self.prefetch_accesses)", SWEPT),
    Mutation("sweep: A is the same as B", "cachesim/sweep.py", "everything, demand = self.streams[0], self.streams[-1]", "everything, demand = self.streams[0], self.streams[0]", SWEPT),
    Mutation("sweep: Parquet's rates as whole numbers", "nptrace_base/records.py", "arrow.get(type_, pa.float64())", "arrow.get(type_, pa.float32())", SWEPT),
    Mutation("plot: with and without swapped", "cachesim/report/curves.py", 'both = [(facts, row["demand_miss_rate"])]', 'both = [(facts, ratio(row["demand_misses_without"], row["demand_accesses"]))]', PLOTTED),
    Mutation("plot: shares of one instead of per cent", "cachesim/report/curves.py", "[100 * rate for rate in line.rates]", "list(line.rates)", PLOTTED),
    # table1
    Mutation("table1: KB of A of 1000 bytes", "cachesim/report/table1.py", "result.config.line_bytes / 1024", "result.config.line_bytes / 1000", TABLE1),
    Mutation("table1: KB of B of 1000 bytes", "cachesim/report/table1.py", "result.bytes_from_memory / 1024", "result.bytes_from_memory / 1000", TABLE1),
    Mutation("table1: a hit costs nothing", "cachesim/report/table1.py", "HIT_CYCLES, MISS_CYCLES = 1, 100", "HIT_CYCLES, MISS_CYCLES = 0, 100", "tests/cachesim/report/test_equation.py"),
    Mutation("table1: N of the trees swapped", "cachesim/report/table1.py", '{"kdtree": 15.77, "bvh": 27.00}', '{"kdtree": 27.00, "bvh": 15.77}', TABLE1),
    Mutation("table1: ours minus the paper's the other way round", "cachesim/report/table1_tables.py", "mine - row.paper[name]", "row.paper[name] - mine", TABLE1),
    Mutation("table1: B's ACPR with the measured N of A", "cachesim/report/table1_tables.py", 'for name in ("acpr_a", "acpr_b")]', 'for name in ("acpr_a", "acpr_a")]', TABLE1),
    Mutation("table1: accesses per primary ray", "cachesim/report/table1.py", "per_ray = ratio(result.demand_accesses, result.n_rays or 0)", "per_ray = ratio(result.demand_accesses + result.prefetch_accesses, result.n_rays or 0)", TABLE1),
    Mutation("table1: two demand columns swapped", "cachesim/report/table1_tables.py", '"demand_ratio", "coverage", "accuracy")\n\n#: What', '"demand_ratio", "accuracy", "coverage")\n\n#: What', TABLE1),
    Mutation("table1: paper's column of the CSV is ours", "cachesim/report/table1.py", 'values[f"{column}_paper"] = _divided(row.paper[name], by, column)', 'values[f"{column}_paper"] = _divided(row.ours[name], by, column)', TABLE1),
    # export
    Mutation("export: the number said leaves the last row group out", "traces/din.py", "written += where.size", "written = where.size - 1", EXPORTED),
    Mutation("export: reads and misc swapped", "traces/din.py", '"read": 0x0, "misc": 0x3', '"read": 0x3, "misc": 0x0', EXPORTED),
    Mutation("export: nodes of 4 bytes", "traces/din.py", "_records(where, what, node_bytes)", "_records(where, what, 4)", EXPORTED),
    # check and scenes
    Mutation("check: exit status always 0", "nptrace/commands/check.py", "    if n_bad:\n        raise SystemExit(1)", "    if n_bad < 0:\n        raise SystemExit(1)", CHECKS),
    Mutation("check: --hard does not count", "nptrace/commands/check.py", 'n_bad = sum(not row["is_good"] for row in rows)', 'n_bad = sum(not row["is_good"] for row in rows if "scene" in row)', CHECKS),
    Mutation("check: hits may differ a hundred times as often", "rtrace/checks/embree.py", "HIT_LIMIT, PRIM_LIMIT = 1e-5, 5e-5", "HIT_LIMIT, PRIM_LIMIT = 1e-3, 5e-5", CHECKS),
    Mutation("check: triangles may differ a hundred times as often", "rtrace/checks/embree.py", "HIT_LIMIT, PRIM_LIMIT = 1e-5, 5e-5", "HIT_LIMIT, PRIM_LIMIT = 1e-5, 5e-3", CHECKS),
    Mutation("check: kappa a hundred times as wide", "rtrace/checks/embree.py", "KAPPA_LIMIT = 128.0", "KAPPA_LIMIT = 12800.0", CHECKS),
    Mutation("check: t may be off by itself", "rtrace/checks/embree.py", "T_LIMIT = 1e-2", "T_LIMIT = 1.0", CHECKS),
    Mutation("check: Embree not in robust mode", "rtrace/checks/embree.py", "EmbreeScene(robust=True)", "EmbreeScene(robust=False)", CHECKS),
    Mutation("check: --seed ignored", "nptrace/commands/check.py", "width, height, n_random, seed, threads)", "width, height, n_random, 0, threads)", CHECKS),
    Mutation("check: a unit of kappa from one edge", "rtrace/checks/embree.py", "np.linalg.norm(e1, axis=1) * np.linalg.norm(e2, axis=1)", "np.linalg.norm(e1, axis=1) ** 2 * 3", CHECKS),
    Mutation("check: trees not compared with each other's t", "rtrace/checks/embree.py", "float((~same).sum()), 0.0)", "float((same).sum()), 0.0)", CHECKS),
    Mutation("check: lost and invented swapped in the table", "nptrace/commands/check.py", '("n_rays", "lost", "invented"', '("n_rays", "invented", "lost"', CHECKS),
    Mutation("check: a hard case with unlike rays is good", "rtrace/checks/hard_cases.py", "self.wrong or self.unlike)", "self.wrong)", CHECKS),
    Mutation("check: value and limit swapped", "nptrace/commands/check.py", """f"{r['value']:.3g}", f"{r['limit']:.3g}",""", """f"{r['limit']:.3g}", f"{r['value']:.3g}",""", CHECKS),
    Mutation("scenes: stand-ins of two scenes swapped", "rtrace/scenes/catalog.py", "e.url or \"\", e.stand_in))", "e.url or \"\", e.name))", CHECKS),
    # State between batches
    Mutation("state: OPT's account begins anew with each batch", "cachesim/cache_counts.py", "replay_optimal(lines, ids, access_types, next_use, n_before, self.cache)",
             "self.cache.account[:] = 0\n            replay_optimal(lines, ids, access_types, next_use, n_before, self.cache)", STATE),
    Mutation("state: OPT counts its accesses from 0 in each batch", "cachesim/cache_counts.py", "replay_optimal(lines, ids, access_types, next_use, n_before, self.cache)",
             "replay_optimal(lines, ids, access_types, next_use, 0, self.cache)", STATE),
    Mutation("state: the prefetch unit's stack is empty after a batch", "cachesim/prefetch.py", "        pieces, start, depth = [], 0, self._machine.stack.shape[1]\n", "        pieces, start, depth = [], 0, self._machine.stack.shape[1]\n        self._machine.sp[0] = 0\n", STATE),
    Mutation("state: the tree cache is written in place", "rtrace/trees/tree_cache.py", "with replacing(path) as temporary, open(temporary, \"wb\") as file:", "with open(path, \"wb\") as file:", TREES),
    Mutation("table: nothing is left out on a narrow terminal", "nptrace_base/tables.py", "while excess(1) > 0:", "while False:", FITTED),
    Mutation("table: what is left out is not said", "nptrace_base/tables.py", "if left_out:", "if False:", FITTED),
    Mutation("table: the last of the extra columns goes first", "nptrace_base/tables.py", "kept.remove(going.pop(0))", "kept.remove(going.pop())", FITTED),
    Mutation("identity: a repeated name is not told by its path", "traces/identity.py", "names.count(each.run) > 1", "names.count(each.run) > 2", IDENTITY),
    Mutation("identity: the order is not told", "traces/identity.py", '"order": of.order or "",', '"order": "",', IDENTITY),
    Mutation("identity: cameras of two scenes are told", "traces/identity.py", '"camera": ("scene",)', '"camera": ()', IDENTITY),
    Mutation("identity: width and height swapped", "traces/identity.py", "width=footer.width, height=footer.height", "width=footer.height, height=footer.width", IDENTITY + " tests/nptrace/test_printed_values.py::test_render"),
    Mutation("plot: prefetch policies are one line", "cachesim/report/curves.py", '_DIMENSIONS = ("prefetch", "layout",', '_DIMENSIONS = ("layout",', CURVES),
    Mutation("plot: runs of one name are one line", "cachesim/report/curves.py", "key = (identity, *(of", "key = (identity.run, *(of", CURVES),
    Mutation("plot: layouts have panels before ways have", "cachesim/report/curves.py", '_CROWDING = ("ways",', '_CROWDING = ("layout", "ways",', CURVES),
    Mutation("plot: one cache, one axis without a number", "cachesim/report/curves.py", "axes.xaxis.set_major_locator(FixedLocator(ticks))", "axes.xaxis.set_major_locator(NullLocator())", CURVES),
    Mutation("plot: joined requests are not drawn", "cachesim/report/bars.py", '"joined": (("joined",), "0.5"), ', '', BARS),
    Mutation("plot: misses of levels from accesses", "cachesim/report/bars.py", "[row[missed] for row in members]", "[row[reads] for row in members]", BARS),
    Mutation("plot: the paper's numbers are ours", "cachesim/report/table1_plot.py", '"paper_ratio_paper", {', '"paper_ratio", {', BARS),
    Mutation("plot: a cache of one line more", "cachesim/knees.py", "beyond[min(size + 1,", "beyond[min(size + 2,", KNEES),
    Mutation("plot: a knee on the far side of the line", "cachesim/knees.py", "int(np.argmax(below))", "int(np.argmin(below))", KNEES),
    Mutation("heat: rows from the bottom", "cachesim/heat.py", "return found.reshape(self.shape)", "return found.reshape(self.shape)[::-1]", VIEWED),
    Mutation("heat: each tree on a scale of its own", "nptrace/commands/view.py", "scale = scale_of(label, values[:n_plain], is_signed", "scale = scale_of(label, values[:1], is_signed", VIEWED),
    Mutation("heat: the first run minus the others", "nptrace/commands/view.py", "changes = [each - values[0]", "changes = [values[0] - each", VIEWED),
    Mutation("heat: a picture that is there is replaced", "nptrace/output.py", "if os.path.lexists(path):", "if False:", VIEWED),
    Mutation("heat: cycles of the reads of another cause", "cachesim/clock/by_pixel.py", "number % N_CAUSES] += log[i, 1]", "SPENT_HIT] += log[i, 1]", BY_PIXEL),
    Mutation("heat: a log that is full is taken for whole", "cachesim/clock/by_pixel.py", "if n_logged == len(clock.log):", "if n_logged > len(clock.log):", BY_PIXEL),
    Mutation("heat: what was logged is counted twice", "cachesim/clock/by_pixel.py", '            clock.numbers["n_logged"][0] = 0\n', "", BY_PIXEL),
    Mutation("name: the batch is not in it", "rtrace/run_names.py", 'parts.append(f"batch{shooting.batch}")', "pass", NAMED),
    Mutation("name: a stand-in has the name of the scene", "rtrace/run_names.py", "if scene.stand_in else", "if False else", NAMED),
    Mutation("name: the camera is not in it", "rtrace/scenes/scene.py", "if camera is not None and camera != scene.camera:", "if False:", NAMED),
    Mutation("JSON: infinity is printed", "nptrace_base/records.py", "and not math.isfinite(value)", "and False", "tests/nptrace_base/test_records.py"),
    # The commands with a clock
    Mutation("clocked: the bound of a comparison is the last policy", "cachesim/clock/compare.py", "[REFERENCE, *found.values(), BOUND]", "[REFERENCE, BOUND, *found.values()]", CLOCKED + " -k bound"),
    Mutation("clocked: late prefetches of a class are not accurate", "cachesim/report/tally_tables.py", 'ratio(counts["timely"] + counts["late"], counts["filled"])', 'ratio(counts["timely"], counts["filled"])', CLOCKED + " -k classes"),
    Mutation("clocked: classes without requests are left out", "cachesim/report/tally_tables.py", "if reads or requests:", "if requests:", CLOCKED + " -k classes"),
    Mutation("clocked: a missing matplotlib is found after the comparison", "nptrace/commands/compare.py", "        check_plot(picture)", "        pass", CLOCKED + " -k matplotlib"),
    Mutation("clocked: a missing matplotlib is found after the map", "nptrace/commands/map.py", "        check_plot(picture)", "        pass", CLOCKED + " -k matplotlib"),
    Mutation("clocked: finished parts of a map are timed again", "nptrace/break_even.py", "    if path.exists():", "    if False:", CLOCKED + " -k goes_on"),
    Mutation("clocked: a timeline on stdout has the tables below it", "nptrace/commands/time.py", 'if str(timeline) == "-" and', "if False and", CLOCKED + " -k timeline"),
    Mutation("clocked: events of a timeline last too long", "cachesim/clock/timeline.py", '"dur": length', '"dur": length + 1', CLOCKED + " -k timeline"),
    Mutation("clocked: cycles with and without prefetching swapped in the table", "cachesim/report/timing_tables.py", '"without": lambda r: number(r.cycles_without', '"without": lambda r: number(r.cycles', CLOCKED + " -k tables_of_time"),
    Mutation("clocked: Table I has the cycles of another machine", "cachesim/report/table1.py", 'hit=equation.hit, miss=equation.miss)', 'hit=equation.hit, miss=99)', TABLE1),
]
