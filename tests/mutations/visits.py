# ruff: noqa: E501
# fmt: off
"""Mutations of the rules of visits: packets, shadow rays, margins of strays, zeros, invalid rays, cut chunks, cameras, kernels in Python."""

from tests.mutations.mutation import Mutation

STRAYS, RULES, MEMORY = "tests/rtrace/trees/test_strays.py", "tests/rtrace/test_visit_rules.py", "tests/rtrace/test_memory_of_tracing.py"
PACKETS, RUNS, SHADOWS = "tests/rtrace/test_packets.py", "tests/rtrace/test_packet_runs.py", "tests/rtrace/test_shadow_options.py"
CAMERA, PLAIN = "tests/rtrace/test_camera.py", "tests/nptrace/test_without_jit.py"

MUTATIONS = [
    Mutation("packets: no sign parts them", "rtrace/traversers/packets.py", "if one_sign and r > ZERO and backwards", "if False and backwards", PACKETS + " -k hand"),
    Mutation("packets: rays that have ended go on", "rtrace/traversers/packets_bvh.py", "if not state.is_done[r]:", "if True:", PACKETS + " -k 'equal_the_slow or lattice'"),
    Mutation("packets: a BVH never drains", "rtrace/traversers/packets_bvh.py", "if n_live == ZERO and not packets.drains:", "if n_live == ZERO:", PACKETS + " -k hand"),
    Mutation("packets: a BVH's order is that of its first ray, active or not", "rtrace/traversers/packets_bvh.py", "state.backwards[state.active[ZERO]]", "state.backwards[ZERO]", PACKETS + " -k 'equal_the_slow or lattice'"),
    Mutation("packets: kd entries beyond every hit are read", "rtrace/traversers/packets_kdtree.py", " and not state.entry[at] > state.best[r]", "", PACKETS + " -k hand"),
    Mutation("packets: kd rays keep their whole interval in the far cell", "rtrace/traversers/packets_kdtree.py", "low if low > t0 else t0\n        at", "t0\n        at", PACKETS + " -k 'hand or lattice'"),
    Mutation("packets: the cheaper child of a kd node is the other", "rtrace/traversers/packets_kdtree.py", "np.uint64(packets.cheaper[node]) == upper_first", "np.uint64(packets.cheaper[node]) != upper_first", SHADOWS + " -k cheaper_child"),
    Mutation("packets: a drained kd ray ends at any hit", "rtrace/traverse.py", "any_hit, drains = False, False", "drains = False", SHADOWS + " -k drained"),
    Mutation("packets: squares in the order of their rows", "rtrace/packets.py", "np.argsort(first[square], kind", "np.argsort(square, kind", RUNS + " -k aligned_square"),
    Mutation("packets: batches of single packets", "rtrace/chunk.py", "packet_starts(pixels, shooting)[batch:-1:batch]", "packet_starts(pixels, shooting)[1:-1]", RUNS + " -k 'rows_of_a_run and random'"),
    Mutation("packets: shadow rays walk alone", "rtrace/chunk.py", "None if packet is None else packet[owner]", "None", RUNS + " -k 'rows_of_a_run and tile'"),
    Mutation("packets: the clock takes them for rays", "cachesim/clock/stretches.py", "if source.run.footer.packet > 1:", "if False:", RUNS + " -k why_not"),
    Mutation("packets: usual runs say so too", "traces/footer.py", "if values[name] == usual:", "if values[name] is None:", "tests/traces/test_footer.py -k usual"),
    Mutation("shadow rays: the cheaper child is the smaller", "rtrace/trees/rtsah.py", "cost[a] + passes[a] * cost[b], cost[b] + passes[b] * cost[a]", "cost[a], cost[b]", "tests/rtrace/trees/test_rtsah.py"),
    Mutation("shadow rays: of surfaces that face away begin inside", "rtrace/shading.py", "if cosine < 0.0:", "if False:", SHADOWS + " -k own_ray"),
    Mutation("shadow rays: without a hit begin where the box begins", "rtrace/shading.py", "t = far if near <= far else", "t = near if near <= far else", SHADOWS + " -k without_a_hit"),
    Mutation("strays: none ever", "rtrace/trees/strays.py", "return limit if limit < farthest < _LARGEST else np.inf", "return np.inf", STRAYS),
    Mutation("strays: a box beyond the largest float32", "rtrace/trees/strays.py", "limit < farthest < _LARGEST", "limit < farthest", STRAYS),
    Mutation("strays: no room around their boxes", "rtrace/trees/strays.py", "slack = SLACK * size[strays, None]", "slack = 0.0 * size[strays, None]", STRAYS),
    Mutation("strays: no room around their parts in a kd-tree", "rtrace/trees/strays.py", "return SLACK * largest if largest > limit else 0.0", "return 0.0", STRAYS),
    Mutation("strays: they belong to the core", "rtrace/trees/strays.py", "near[strays] = False", "near[strays] = True", STRAYS),
    Mutation("strays: binned records keep their tight boxes", "rtrace/trees/binned_sah.py", "boxes[:, :3], boxes[:, 3:6] = lower, NOTHING - upper", "pass", STRAYS),
    Mutation("clip: parts of strays do not reach across the plane", "rtrace/trees/clip.py", "low_plane, high_plane = position - slack, position + slack", "low_plane, high_plane = position, position", STRAYS),
    Mutation("clip: bounds of parts of strays are tight", "rtrace/trees/clip.py", "min(hi, _rank_above(upper + slack))", "min(hi, _rank_above(upper))", STRAYS),
    Mutation("tree cache: the core is the whole box", "rtrace/trees/tree_cache.py", "np.stack((tree.bounds, tree.core))", "np.stack((tree.bounds, tree.bounds))", "tests/rtrace/trees/test_tree_cache.py"),
    Mutation("traversal: the inverse of a zero has its sign", "rtrace/intersect.py", "return 1.0 / d if d != 0.0 else HUGE", "return 1.0 / d if d != 0.0 else np.copysign(HUGE, d)", RULES),
    Mutation("traversal: rays that are none are traced", "rtrace/intersect.py", "return t_max if total - total == 0.0 and (dx != 0.0 or dy != 0.0 or dz != 0.0) else np.nan", "return t_max", RULES),
    Mutation("traversal: rays without a direction are traced", "rtrace/intersect.py", " and (dx != 0.0 or dy != 0.0 or dz != 0.0) else np.nan", " else np.nan", RULES),
    Mutation("room: holds any number of events", "rtrace/traverse.py", "room.events.size >= room.most", "room.events.size >= 1000 * room.most", MEMORY),
    Mutation("room: a long ray alone is refused too", "rtrace/traverse.py", "if n_together > 1 and room.most is not None", "if room.most is not None", MEMORY),
    Mutation("chunks: halves of a batch keep their shadow rays", "rtrace/chunk.py", "return [(start, stop, PRIMARY), (start, stop, SHADOW)]", "return [(start, start + 1, None), (start + 1, stop, None)]", MEMORY),
    Mutation("chunks: pieces of a chunk in the wrong order", "rtrace/render.py", "reversed(smaller_pieces(start, stop, batch, which))", "smaller_pieces(start, stop, batch, which)", MEMORY),
    Mutation("chunks: the limit is not handed on", "rtrace/render.py", "batch, which, MOST_EVENTS", "batch, which, None", MEMORY),
    Mutation("chunks: pixels counted in both passes", "rtrace/render.py", "if chunk.is_shaded:", "if True:", MEMORY),
    Mutation("camera: an eye of any size", "rtrace/camera.py", "if max(map(abs, self.eye)) > FARTHEST:", "if False:", CAMERA),
    Mutation("camera: a field of any width", "rtrace/camera.py", "if self.fov < MIN_FOV:", "if False:", CAMERA),
    Mutation("camera: fitted beyond float32", "rtrace/camera.py", "np.where(np.abs(eye) > FARTHEST, middle + distance * forward, eye)", "eye", CAMERA),
    Mutation("plain: smaller lanes are larger", "rtrace/simd.py", "lambda *lanes: tuple(a if a < b else b", "lambda *lanes: tuple(b if a < b else a", PLAIN),
    Mutation("plain: boxes do not grow", "rtrace/trees/binned_sah.py", "_on_eight_words(_least, np.fmin)", "_on_eight_words(_least, np.fmax)", PLAIN),
    Mutation("plain: the line carried is dropped", "cachesim/all_associativity.py", "    group[0] = carried\n", "", PLAIN),
    Mutation("plain: warnings of NumPy's scalars", "nptrace_base/jit.py", 'with np.errstate(all="ignore"):', "if True:", PLAIN),
]
