"""More mutations for ``tests.mutations``: builders, clipping and sorting; sweep, stack distances, filter and OPT; whole files."""

# ruff: noqa: E501
# fmt: off

from tests.mutation_list import Mutation

KD, BVH, SORT = "tests/test_kdtree.py", "tests/test_bvh.py", "tests/test_sorting.py"
SWEEP, OPT = "tests/test_cachesim_sweep.py", "tests/test_cachesim_opt.py"
FORMAT, FAULTS, FUZZ = "tests/test_format.py", "tests/test_faults.py", "tests/test_fuzz.py"
SW, LE, RE, FI = "cachesim/sweep.py", "cachesim/levels.py", "cachesim/reuse.py", "cachesim/filter.py"
LI, NU, EX, RP = "cachesim/lists.py", "cachesim/nextuse.py", "cachesim/exact.py", "cachesim/replay.py"
KT, CL, BV, SO = "rtrace/kdtree.py", "rtrace/clip.py", "rtrace/bvh.py", "rtrace/sorting.py"

MUTATIONS = [
    # --- sorting ---
    Mutation("sorting: the last run is not merged", SO, "for begin in range(0, n - run, 2 * run):", "for begin in range(0, n - 2 * run, 2 * run):", SORT),
    Mutation("sorting: runs are merged only once", SO, "run *= 2", "run *= 2 * n", SORT),
    Mutation("sorting: insertion stops one key early", SO, "for i in range(begin + 1, min(begin + _RUN, n)):", "for i in range(begin + 1, min(begin + _RUN, n - 1)):", SORT),
    Mutation("sorting: keys beyond the n-th are sorted too", SO, "end = min(begin + 2 * run, n)", "end = min(begin + 2 * run, keys.size)", SORT),
    # --- kd-tree ---
    Mutation("kd-tree: half the area leaves a face out", KT, "return dx * dy + dy * dz + dz * dx", "return dx * dy + dy * dz", KD),
    Mutation("kd-tree: traversal costs nothing", KT, "fixed = trav * (cap + (hi - lo) * rim)", "fixed = 0.0 * (cap + (hi - lo) * rim)", KD),
    Mutation("kd-tree: no bonus for an empty lower child", KT, "trial = empty_bonus * (fixed + (cap + (hi - first) * rim) * n)", "trial = fixed + (cap + (hi - first) * rim) * n", KD),
    Mutation("kd-tree: no bonus for an empty upper child", KT, "trial = empty_bonus * (fixed + (cap + (last - lo) * rim) * n)", "trial = fixed + (cap + (last - lo) * rim) * n", KD),
    Mutation("kd-tree: a plane at the lower border of the cell is tried", KT, "if trial < cost and first > lo:", "if trial < cost and first >= lo:", KD),
    Mutation("kd-tree: triangles that end at a plane count above it", KT, "above -= kind == _END", "above -= 0", KD),
    Mutation("kd-tree: triangles that start do not count below", KT, "below += kind == _START", "below += 0", KD),
    Mutation("kd-tree: one planar triangle of a run counts", KT, "planar += 1\n", "planar = np.int64(1)\n", KD),
    Mutation("kd-tree: straddlers stay below", KT, "_BOTH if event & _KIND == _START else _BELOW", "_BELOW", KD),
    Mutation("kd-tree: what ends above the plane is taken above", KT, "side[triangle] if event & _KIND == _END else _ABOVE", "_ABOVE", KD),
    Mutation("kd-tree: straddlers keep their upper bound", KT, "            if kind != _START:\n                bounds[at + 3] = event >> 32", "            if kind == _PLANAR:\n                bounds[at + 3] = event >> 32", KD),
    Mutation("kd-tree: a part that has become flat keeps two events", KT, "n += 0 if flat and kind == _END else 1", "n += 1", KD),
    Mutation("kd-tree: both ends of a part at its lower bound", KT, "((hi if kind == _END else lo) << 32)", "(lo << 32)", KD),
    Mutation("kd-tree: merged events in the order of arrival", KT, "if i >= begin and events[axis, i] > fresh[j]:", "if i >= begin and events[axis, i] > fresh[0]:", KD),
    Mutation("kd-tree: leaves list the ends of triangles too", KT, "n += events[0, i] & _KIND != _END", "n += 1", KD),
    Mutation("kd-tree: the upper child takes the lower one's bounds", KT, "n_fresh = _renew(cut, k, n_cut, slot, above, fresh)", "n_fresh = _renew(cut, k, n_cut, slot, below, fresh)", KD),
    Mutation("kd-tree: the lower child's box reaches up to its parent's", KT, "boxes[6 * cell + 9 + axis] = split", "boxes[6 * cell + 9 + axis] = boxes[6 * cell + 3 + axis]", KD),
    Mutation("kd-tree: the deepest level is not noted", KT, "state[_DEEPEST] = max(state[_DEEPEST], level + 1)", "state[_DEEPEST] = max(state[_DEEPEST], level)", KD),
    Mutation("kd-tree: split although a leaf is as cheap", KT, "best = (half_area * n, np.int64(0)", "best = (half_area * n * 1.01 + 1e-30, np.int64(0)", KD),
    # --- clipping ---
    Mutation("clipping: ranks of negative numbers the wrong way round", CL, "return bits if bits >= 0 else -2147483648 - bits", "return bits", KD),
    Mutation("clipping: lower bounds are rounded inward", CL, "return place - 1 if value(place) > x else place", "return place", KD),
    Mutation("clipping: upper bounds are rounded inward", CL, "return place + 1 if value(place) < x else place", "return place", KD),
    Mutation("clipping: an edge is cut from whichever end comes first", CL, "    if points[a + axis] > plane:\n        a, b = b, a\n", "", KD),
    Mutation("clipping: the crossing point is not put on the plane", CL, "    points[out + axis] = plane\n", "", KD),
    Mutation("clipping: corners on the plane are lost", CL, "if here * side >= 0.0:", "if here * side > 0.0:", KD),
    Mutation("clipping: the last edge is left open", CL, "        b = a + 3 if i + 1 < n else first\n        here, there = points[a + axis] - plane, points[b + axis] - plane\n        if here * side", "        b = a + 3 if i + 1 < n else a\n        here, there = points[a + axis] - plane, points[b + axis] - plane\n        if here * side", KD),
    Mutation("clipping: bounds outgrow those of the cell before", CL, "inner_lo, inner_hi = max(lo, _rank_below(lower)), min(hi, _rank_above(upper))", "inner_lo, inner_hi = _rank_below(lower), _rank_above(upper)", KD),
    Mutation("clipping: the lower part reaches beyond the plane", CL, "lo, min(hi, split) if k == axis else hi, below", "lo, hi, below", KD),
    Mutation("clipping: parts bounded by corners alone", CL, "            _cross(points, a, b, axis, plane, end)\n            end += 3\n    for k in range(3):\n        below_lo", "            _cross(points, a, b, axis, plane, end)\n    for k in range(3):\n        below_lo", KD),
    # --- BVH ---
    Mutation("BVH: half the area leaves a face out", BV, "return dx * dy + dy * dz + dz * dx", "return dx * dy + dy * dz", BVH),
    Mutation("BVH: the right side's area one triangle short", BV, "right_area[i + 1] * (end - i - 1)", "right_area[i + 1] * (end - i - 2)", BVH),
    Mutation("BVH: the highest of equal costs is taken", BV, "        if cost < best:\n            best, position = cost, i + 1", "        if cost <= best:\n            best, position = cost, i + 1", BVH),
    Mutation("BVH: the z axis is never tried", BV, "    for k in range(3):\n        cost, position", "    for k in range(2):\n        cost, position", BVH),
    Mutation("BVH: the longest axis is the shortest", BV, "if dx >= dy and dx >= dz:", "if dx <= dy and dx <= dz:", BVH),
    Mutation("BVH: a child's box from its parent's triangles", BV, "_box_of(order, start, position, boxes, nodes, n_nodes)", "_box_of(order, start, end, boxes, nodes, n_nodes)", BVH),
    Mutation("BVH: the level of a right child is its parent's", BV, "n_nodes + 1, position, end, level + 1", "n_nodes + 1, position, end, level", BVH),
    # --- sweep ---
    Mutation("sweep: the upper end of a range is left out", SW, "range(int(low), int(high) + 1)", "range(int(low), int(high))", f"{SWEEP} -k range"),
    Mutation("sweep: sizes outside the ranges", SW, "any(low <= size <= high for low, high in sizes)", "any(size <= high for low, high in sizes)", f"{SWEEP} -k grid"),
    Mutation("sweep: full only for powers of two", SW, "possible |= {end for ends in sizes for end in ends if end and end % line == 0}", "pass", f"{SWEEP} -k grid"),
    Mutation("sweep: a size twice", SW, "return list(dict.fromkeys(configs))", "return configs + configs[:1]", f"{SWEEP} -k grid"),
    Mutation("sweep: other policies than LRU accepted", SW, 'if config.policy != "lru":', 'if config.policy == "mru":', f"{SWEEP} -k refused"),
    Mutation("sweep: any number of sets accepted", SW, "if config.n_sets & (config.n_sets - 1):", "if config.n_sets < 0:", f"{SWEEP} -k refused"),
    Mutation("sweep: pre-fetchers that react are accepted", RE, "if prefetch.trigger:", "if prefetch.trigger > 9:", f"{SWEEP} -k refused"),
    Mutation("sweep: the last batch is not waited for", SW, "        for step in running:\n            step.result()\n    return", "    return", SWEEP),
    Mutation("sweep: a batch does not wait for the one before", SW, "            for step in running:\n                step.result()\n            running", "            running", SWEEP),
    Mutation("sweep: A counts the pre-fetches too", SW, "own, own_labels = demand_only(lines, labels)", "own, own_labels = lines, labels", SWEEP),
    Mutation("sweep: misses of A are those of B", SW, "demand_misses_without=demand.misses(config)[0]", "demand_misses_without=demand_misses", SWEEP),
    Mutation("sweep: pre-fetches counted as demand accesses", SW, "self.n_demand += labels.size - n_prefetches", "self.n_demand += labels.size", SWEEP),
    Mutation("sweep: traffic ratio of demand misses alone", SW, '"traffic_ratio": ratio(misses, self.demand_misses_without)', '"traffic_ratio": ratio(self.demand_misses, self.demand_misses_without)', SWEEP),
    Mutation("sweep: full caches through the levels", SW, "several = [config for config in configs if config.n_sets > 1]", "several = [config for config in configs if config.n_sets > 2]", SWEEP),
    # --- levels ---
    Mutation("levels: the first level is the second", LE, "self._first, n_levels = min(exponents), max(exponents) - min(exponents) + 1", "self._first, n_levels = min(exponents) + 1, max(exponents) - min(exponents) + 1", f"{SWEEP} -k cell"),
    Mutation("levels: misses from one way less", LE, "self.counts[level, :, config.ways - 1 :]", "self.counts[level, :, config.ways :]", f"{SWEEP} -k cell"),
    Mutation("levels: pre-fetches among the demand", LE, "k = n_depths if labels[i] >= PREFETCH else ZERO", "k = ZERO", f"{SWEEP} -k cell"),
    Mutation("levels: the walk goes on at the newest line", LE, "            if carried == line:\n                break\n", "            if carried == line:\n                pass\n", f"{SWEEP} -k cell"),
    Mutation("levels: the walk stops at the second line too", LE, "                counts[k] += 1\n", "                counts[k] += 1\n                break\n", f"{SWEEP} -k cell"),
    Mutation("levels: the line carried down is dropped", LE, "newest[at], newest[at + ONE] = line, carried", "newest[at], newest[at + ONE] = line, second", f"{SWEEP} -k cell"),
    Mutation("levels: depth one too small", LE, "counts[k + ONE + depth] += 1", "counts[k + depth] += 1", f"{SWEEP} -k cell"),
    Mutation("levels: lines beyond the sixteenth forgotten", LE, "if depth == SIXTEEN and n_oldest:", "if depth == SIXTEEN and n_oldest > SIXTEEN * SIXTEEN:", f"{SWEEP} -k cell"),
    Mutation("levels: lines beyond the thirty-second forgotten", LE, "            at += SIXTEEN\n", "            break\n", f"{SWEEP} -k cell"),
    Mutation("levels: sets of a level overlap those before", LE, "level += mask + ONE", "level += mask", f"{SWEEP} -k cell"),
    Mutation("levels: the same sets at every level", LE, "mask += mask + ONE", "mask += ZERO", f"{SWEEP} -k cell"),
    Mutation("levels: the mask leaves the line's own lane", LE, "builder.sub(ir.Constant(i64, LANES), lane)", "builder.sub(ir.Constant(i64, LANES), builder.lshr(lane, ir.Constant(i64, 1)))", f"{SWEEP} -k cell"),
    # --- stack distances ---
    Mutation("reuse: an immediate repeat counts as distance 2", RE, "counts[TWO + is_prefetch] += 1", "counts[TWO * TWO + is_prefetch] += 1", f"{SWEEP} -k distance"),
    Mutation("reuse: a new line is not counted live", RE, "            n_live += ONE\n", "            n_live += ZERO\n", f"{SWEEP} -k distance"),
    Mutation("reuse: the old slot stays live in the current word", RE, "                current ^= ONE << bit\n", "", f"{SWEEP} -k distance"),
    Mutation("reuse: the old slot stays live in an older word", RE, "live[word] = bits ^ (ONE << bit)", "live[word] = bits", f"{SWEEP} -k distance"),
    Mutation("reuse: words in between are left out", RE, "for k in range(1, _NEAR):", "for k in range(2, _NEAR):", f"{SWEEP} -k distance"),
    Mutation("reuse: far distances off by the line itself", RE, "distance = n_live - older", "distance = n_live - older - ONE", f"{SWEEP} -k distance"),
    Mutation("reuse: sums keep removed slots", RE, "                    remove(word, here - NEAR, in_group, to_group)\n", "", f"{SWEEP} -k distance"),
    Mutation("reuse: sums of later groups keep removed slots", RE, "        to_group[group] -= 1\n", "        to_group[group] -= 0\n", f"{SWEEP} -k distance"),
    Mutation("reuse: the sum of a new group starts at nothing", RE, "to_group[word >> SIX] = np.uint64(to_group[before >> SIX]) + n", "to_group[word >> SIX] = n", f"{SWEEP} -k distance"),
    Mutation("reuse: slots are not numbered anew", RE, "            renumber(*arrays)\n            pack", "            pack", f"{SWEEP} -k distance"),
    Mutation("reuse: one slot too few is packed", RE, "live[full] = (ONE << (n & SIXTY_THREE)) - ONE", "live[full] = (ONE << (n & SIXTY_THREE)) >> ONE", f"{SWEEP} -k distance"),
    Mutation("reuse: first accesses hit", RE, "self.counts[0] + self.counts[n_lines + 1 :].sum(axis=0)", "self.counts[n_lines + 1 :].sum(axis=0)", f"{SWEEP} -k distance"),
    Mutation("reuse: a cache of n lines misses at distance n", RE, "self.counts[n_lines + 1 :]", "self.counts[n_lines:]", f"{SWEEP} -k distance"),
    Mutation("reuse: counts are lost when there is more room", RE, "counts[: self.counts.shape[0]], slot[: self._slot.size] = self.counts, self._slot", "slot[: self._slot.size] = self._slot", f"{SWEEP} -k distance"),
    # --- filter ---
    Mutation("filter: the last line of any set is dropped", FI, "s = np.uint64(set_of(np.int64(line), n_sets, mask))", "s = np.uint64(set_of(np.int64(line), n_sets, mask)) // np.uint64(2)", f"{SWEEP} -k filter"),
    Mutation("filter: nothing is remembered", FI, "        newest[s] = tag\n", "", f"{SWEEP} -k filter"),
    Mutation("filter: a first use after a pre-fetch is dropped", FI, "        if keep_first_use and label >= PREFETCH:\n            tag ^= ONE", "        if keep_first_use and label >= PREFETCH:\n            tag ^= np.uint64(0)", f"{SWEEP} -k filter"),
    Mutation("filter: any number of sets is taken as exact", FI, "if config.n_sets % n_sets:", "if config.n_sets < n_sets:", f"{SWEEP} -k filter"),
    Mutation("filter: any line size is taken as exact", FI, "if config.line_bytes != line_bytes:", "if config.line_bytes < line_bytes:", f"{SWEEP} -k filter"),
    Mutation("filter: the largest common number of sets is the smallest", FI, "return gcd(*(config.n_sets for config in configs)) or 1", "return min(config.n_sets for config in configs)", f"{SWEEP} -k filter"),
    # --- OPT ---
    Mutation("opt: the line used soonest goes", LI, "if due[slots[parent]] > due[line_id]:", "if due[slots[parent]] < due[line_id]:", OPT),
    Mutation("opt: the left child of the heap is never compared", LI, "child = root + 2 * (slot - root) + 1", "child = root + 2 * (slot - root) + 2", OPT),
    Mutation("opt: the smaller child rises", LI, "due[slots[child + 1]] > due[slots[child]]", "due[slots[child + 1]] < due[slots[child]]", OPT),
    Mutation("opt: a hit does not move the line", LI, "        if lists.policy == OPT:\n            _sift_up(", "        if lists.policy == OPT and line_id < 0:\n            _sift_up(", OPT),
    Mutation("opt: the heap of every set is that of the first", LI, "    root = s * lists.ways\n    if lists.held", "    root = 0 * lists.ways\n    if lists.held", OPT),
    Mutation("opt: the place of a line that sinks is not noted", LI, "        lists.links[2 * (lists.n_sets + slots[slot])] = slot\n        slot = parent", "        slot = parent", OPT),
    Mutation("opt: next uses are lost when lines are added", LI, "    due[: lists.due.size] = lists.due\n", "", f"{OPT} -k room"),
    Mutation("opt: the next use is that of the access before", NU, "next_use[last[line_id] - 1] = here", "next_use[last[line_id] - 1] = here - 1", OPT),
    Mutation("opt: a line not used again is kept", NU, "        next_use[here] = NO_MORE\n", "        next_use[here] = 0\n", OPT),
    Mutation("opt: every batch begins the future anew", NU, "        self.n_taken += n\n        return self._next[self.n_taken - n : self.n_taken]", "        return self._next[:n]", OPT),
    Mutation("opt: the oldest of the unused lines stays", EX, "due = _LATE - start - i", "due = _LATE + start + i", OPT),
    Mutation("opt: the shadow does not know the future", EX, "            cache.shadow.due[line_id] = due\n", "            pass\n", OPT),
    Mutation("opt: pre-fetchers that react are accepted", RP, "        check_foreseeable(prefetch)\n", "", OPT),
    # --- whole files ---
    Mutation("files: written in place", "traces/whole.py", "temporary = path.with_name(f\".{path.stem}.{os.getpid()}-{secrets.token_hex(4)}.tmp{path.suffix}\")", "temporary = path", f"{SWEEP} -k whole"),
    Mutation("files: what a failed writer left stays", "traces/whole.py", "        temporary.unlink(missing_ok=True)\n", "        pass\n", f"{SWEEP} -k whole"),
    Mutation("files: what a killed writer left stays", "traces/whole.py", "    _sweep(path)\n", "", f"{FAULTS} -k sweeps"),
    Mutation("format: a damaged picture opens", "traces/format.py", 'if metadata.get("image_sha256", image) != image:', 'if metadata.get("image_sha256", image) == "":', f"{FAULTS} -k flipped"),
    Mutation("format: pages are not checked", "traces/format.py", "pq.ParquetFile(file, page_checksum_verification=True)", "pq.ParquetFile(file)", FORMAT),
    Mutation("format: a footer that is no object is an error of ours", "traces/format.py", "except (ValueError, TypeError, KeyError, RecursionError) as e:", "except ValueError as e:", f"{FUZZ} -k footers"),
    Mutation("sweep: a range of ways of any length", SW, "if numbers[-1] - numbers[0] >= MAX_RANGE:", "if numbers[-1] - numbers[0] >= 1 << 20:", f"{SWEEP} -k range"),
]
