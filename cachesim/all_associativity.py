"""The kernel of a sweep: lines and access types in, for every number of sets a histogram of LRU depths out.

For each number of sets, from few to many, each set keeps its lines newest first; the depth at which a line is found says which
numbers of ways hit (``cachesim.sweep`` has the argument). Depths are compared 16 at a time.
"""

from collections.abc import Sequence
from typing import Any

import numpy as np
from llvmlite import ir
from numba import types

from cachesim.access import PREFETCH
from cachesim.config import CacheConfig
from nptrace_base.jit import instructions, kernel

#: Lines compared at once: what AVX-512 holds in one register and AVX2 in two.
LANES = 16
NO_LINE = 0xFFFFFFFF

ZERO, ONE = np.uint64(0), np.uint64(1)
N_NEWEST, N_LANES = np.uint64(2), np.uint64(LANES)  # lines of a set that are kept together


class SetCounts:
    """Every LRU cache with the numbers of sets and ways of some configurations, for one stream of lines.

    Number k of sets is 2^(first + k); its sets follow those of the number before.

    Attributes
    ----------
    counts : (n_set_counts, 2, depths) int64
        Demand accesses and prefetches that found their line at depth 1, 2 ... of its set; the last: not at all. Those at
        depth 0, the newest line, are not counted: they hit everywhere.
    """

    def __init__(self, configs: Sequence[CacheConfig]) -> None:
        exponents = [config.n_sets.bit_length() - 1 for config in configs]
        self._first, n_set_counts = min(exponents), max(exponents) - min(exponents) + 1
        n_deeper = max(-(-(max(config.ways for config in configs) - 2 - LANES) // LANES), 0)
        n_sets = (1 << (self._first + n_set_counts)) - (1 << self._first)
        self._newest = _aligned(2 * n_sets)  # the two newest lines of each set
        self._older = _aligned(LANES * n_sets)  # the next ones
        self._oldest = _aligned(LANES * n_deeper * n_sets)  # and those beyond, if there are so many ways
        self.counts = np.zeros((n_set_counts, 2, 2 + LANES + LANES * n_deeper), np.int64)

    def step(self, lines: np.ndarray, access_types: np.ndarray) -> None:
        """Take the next (line uint32, access type uint8) pairs."""
        walk(lines, access_types, self._first, self.counts.shape[0], self._newest, self._older, self._oldest,
             self.counts.reshape(-1), self.counts.shape[2])  # fmt: skip

    def misses(self, config: CacheConfig) -> tuple[int, int]:
        """Return the misses of demand accesses and of prefetches in one cache."""
        k = config.n_sets.bit_length() - 1 - self._first
        demand, prefetch = self.counts[k, :, config.ways - 1 :].sum(axis=1)
        return int(demand), int(prefetch)


def _aligned(n: int) -> np.ndarray:
    """Return n empty places for lines, from a multiple of 64 bytes on: elsewhere the walk took 1.05 to 1.15 times the time."""
    memory = np.full(n + LANES, NO_LINE, np.uint32)
    start = -(memory.ctypes.data // 4) % LANES
    return memory[start : start + n]


def _put_first(lines, at, line, carried):
    """Return what ``put_first`` does, in Python."""
    group = lines[int(at) : int(at) + LANES]
    last = group[-1]
    lane = int(np.argmax(np.append(group == line, True)))
    moved = min(lane, LANES - 1)
    group[1 : moved + 1] = group[:moved].copy()
    group[0] = carried
    return np.uint64(lane), np.uint64(last)


@instructions(_put_first)
def put_first(typing_context, lines, at, line, carried):
    """Move ``line`` out of and ``carried`` into the ``LANES`` lines from ``at`` on, newest first, all lanes at once.

    Returns (lane of the line, or LANES if it is not there, which drops the last; the last line as it was).

    In LLVM's own instructions, because Numba's loops over so few lines do not become vectors. Measured against moving one line
    after the other, the whole walk took 0.69 to 0.78 of the time with AVX-512, 0.64 to 0.83 with AVX2, 0.82 to 1.01 with SSE2;
    on a run whose branches are all predicted 1.08, 1.10 and 1.8.
    """
    signature = types.UniTuple(types.uint64, 2)(lines, types.uint64, types.uint32, types.uint32)

    def generate(context: Any, builder: Any, signature: Any, args: Any) -> Any:
        i32, i64 = ir.IntType(32), ir.IntType(64)
        vector, none = ir.VectorType(i32, LANES), ir.Constant(ir.VectorType(i32, LANES), ir.Undefined)
        data = context.make_array(signature.args[0])(context, builder, args[0]).data
        place = builder.bitcast(builder.gep(data, [args[1]]), vector.as_pointer())
        old = builder.load(place)
        old.align = 4
        zero = ir.Constant(i32, 0)
        wanted = builder.insert_element(none, args[2], zero)
        wanted = builder.shuffle_vector(wanted, none, ir.Constant(vector, [0] * LANES))
        is_line = builder.bitcast(builder.icmp_unsigned("==", old, wanted), ir.IntType(LANES))
        is_line = builder.or_(builder.zext(is_line, i64), ir.Constant(i64, 1 << LANES))
        lane = builder.cttz(is_line, ir.Constant(ir.IntType(1), 1))
        moved = builder.shuffle_vector(
            old, builder.insert_element(none, args[3], zero), ir.Constant(vector, [LANES, *range(LANES - 1)])
        )
        # The lanes up to the line's take what the lane before them held: a window of -1, ..., -1, 0, ..., 0 is their mask. As
        # the bits of an integer the mask took 1.7 to 3 times the time of the walk with AVX2, 0.85 to 1 with AVX-512.
        masks = builder.module.globals.get("sweep_masks")
        if masks is None:
            ones_and_zeros = ir.ArrayType(i32, 2 * LANES + 1)
            masks = ir.GlobalVariable(builder.module, ones_and_zeros, "sweep_masks")
            masks.linkage, masks.global_constant = "internal", True
            masks.initializer = ir.Constant(ones_and_zeros, [-1] * (LANES + 1) + [0] * LANES)
        window = builder.gep(masks, [ir.Constant(i64, 0), builder.sub(ir.Constant(i64, LANES), lane)])
        mask = builder.load(builder.bitcast(window, vector.as_pointer()))
        mask.align = 4
        new = builder.or_(builder.and_(moved, mask), builder.and_(old, builder.not_(mask)))
        builder.store(new, place).align = 4
        last = builder.zext(builder.extract_element(old, ir.Constant(i32, LANES - 1)), i64)
        return context.make_tuple(builder, signature.return_type, (lane, last))

    return signature, generate


@kernel
def walk(lines, access_types, first, n_set_counts, newest, older, oldest, counts, n_depths):
    """Access each line at one number of sets after the other, from 2^first on, until it is the newest of its set.

    ``counts`` has ``n_depths`` bins for the demand accesses and as many for the prefetches of each number of sets.
    """
    n_depths, n_oldest = np.uint64(n_depths), np.uint64(2 * oldest.size // newest.size)
    first_mask, bins_of_both = (ONE << np.uint64(first)) - ONE, n_depths + n_depths
    for i in range(lines.size):
        line = lines[i]
        bins = n_depths if access_types[i] >= PREFETCH else ZERO
        end = bins + np.uint64(n_set_counts) * bins_of_both
        first_set, mask = ZERO, first_mask
        while bins < end:
            s = first_set + (np.uint64(line) & mask)
            first_line, second_line = N_NEWEST * s, N_NEWEST * s + ONE
            carried = newest[first_line]
            if carried == line:
                break
            second = newest[second_line]
            newest[first_line], newest[second_line] = line, carried
            # A branch, because half of what comes here is at depth 1; without it the walk took 1.15 times the time.
            if second == line:
                counts[bins] += 1
            else:
                depth, last = put_first(older, N_LANES * s, line, second)
                if depth == N_LANES and n_oldest:
                    at = n_oldest * s
                    bound = at + n_oldest
                    while at < bound:
                        lane, last = put_first(oldest, at, line, np.uint32(last))
                        depth += lane
                        if lane < N_LANES:
                            break
                        at += N_LANES
                counts[bins + ONE + depth] += 1
            first_set += mask + ONE
            mask += mask + ONE
            bins += bins_of_both
