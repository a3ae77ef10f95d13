"""The kernel of a sweep: lines and access types in, for every number of sets a histogram of LRU depths out.

For each number of sets, from few to many, each set keeps its lines newest first; the depth at which a line is found says which
numbers of ways hit (``cachesim.sweep`` has the argument). Depths are compared 16 at a time. What is counted is a summary, as
``cachesim.summary`` describes.
"""

from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np
from llvmlite import ir
from numba import types

from cachesim.access import PREFETCH
from cachesim.config import CacheConfig
from nptrace_base.jit import inlined, instructions, kernel

#: Lines compared at once: what AVX-512 holds in one register and AVX2 in two.
LANES = 16
NO_LINE = 0xFFFFFFFF

ZERO, ONE, NOTHING = np.uint64(0), np.uint64(1), np.uint64(NO_LINE)
N_NEWEST, N_LANES = np.uint64(2), np.uint64(LANES)  # lines of a set that are kept together


class SetsByNumber(NamedTuple):
    """The sets of every number of sets, 2^first, 2^(first + 1) ...; the arrays are updated in place.

    Attributes
    ----------
    newest, older, oldest : (n_sets * places,) uint32
        The two newest lines of each set, the next ``LANES``, and those beyond, if there are so many ways; the sets of each
        number follow those of the number before.
    counts : (n_exponents * 2 * n_depths,) int64
        For each number of sets the demand accesses, then the prefetches, by depth from 1 on.
    open_lines, open_types, open_exponents : (n,) uint32, uint8, uint8
        The open accesses, and the lowest exponent (less ``first``) at which each is open.
    n_open : (1,) int64
    first, n_exponents, n_depths, n_oldest : int
        ``n_oldest``: the places of each set in ``oldest``.
    """

    newest: np.ndarray
    older: np.ndarray
    oldest: np.ndarray
    counts: np.ndarray
    open_lines: np.ndarray
    open_types: np.ndarray
    open_exponents: np.ndarray
    n_open: np.ndarray
    first: int
    n_exponents: int
    n_depths: int
    n_oldest: int


class SetCounts:
    """Every LRU cache with the numbers of sets and ways of some configurations, for one stream: a part's summary.

    Number k of sets is 2^(first + k).

    Attributes
    ----------
    counts : (n_exponents, 2, depths) int64
        Demand accesses and prefetches that found their line at depth 1, 2 ... of its set; the last: not at all. Those at
        depth 0, the newest line, are not counted: they hit everywhere.
    """

    def __init__(self, configs: Sequence[CacheConfig]) -> None:
        self._configs = configs
        exponents = [config.n_sets.bit_length() - 1 for config in configs]
        first, n_exponents = min(exponents), max(exponents) - min(exponents) + 1
        n_deeper = max(-(-(max(config.ways for config in configs) - 2 - LANES) // LANES), 0)
        n_sets, n_depths = (1 << (first + n_exponents)) - (1 << first), 2 + LANES + LANES * n_deeper
        n_open = (1 << (first + n_exponents - 1)) * n_depths
        self._sets = SetsByNumber(
            newest=_aligned(2 * n_sets),
            older=_aligned(LANES * n_sets),
            oldest=_aligned(LANES * n_deeper * n_sets),
            counts=np.zeros(n_exponents * 2 * n_depths, np.int64),
            open_lines=np.empty(n_open, np.uint32),
            open_types=np.empty(n_open, np.uint8),
            open_exponents=np.empty(n_open, np.uint8),
            n_open=np.zeros(1, np.int64),
            first=first,
            n_exponents=n_exponents,
            n_depths=n_depths,
            n_oldest=LANES * n_deeper,
        )

    @property
    def counts(self) -> np.ndarray:
        """The counts by number of sets, kind of access and depth."""
        sets = self._sets
        return sets.counts.reshape(sets.n_exponents, 2, sets.n_depths)

    def step(self, lines: np.ndarray, access_types: np.ndarray) -> None:
        """Take the next (line uint32, access type uint8) pairs."""
        walk(lines, access_types, self._sets)

    def misses(self, config: CacheConfig) -> tuple[int, int]:
        """Return the misses of demand accesses and of prefetches in one cache."""
        k = config.n_sets.bit_length() - 1 - self._sets.first
        demand, prefetch = self.counts[k, :, config.ways - 1 :].sum(axis=1)
        return int(demand), int(prefetch)

    def then(self, later: "SetCounts") -> "SetCounts":
        """Return the summary of this part and the one that follows; neither changes."""
        whole, arrays = SetCounts(self._configs), later.arrays()
        whole.load(self.arrays())
        lines, types, exponents = (arrays[name] for name in OPENED)
        walk_open(lines, types, exponents, whole._sets)
        whole.counts[:] += later.counts
        opened = np.zeros((whole._sets.n_exponents, 2), np.int64)
        np.add.at(opened, (exponents, (types >= PREFETCH).astype(np.intp)), 1)
        whole.counts[:, :, -1] -= np.cumsum(opened, axis=0)
        for name in PLACES:
            mine, its = getattr(whole._sets, name), arrays[name]
            np.copyto(mine, its, where=its != NO_LINE)
        return whole

    def arrays(self) -> dict[str, np.ndarray]:
        """Return all that the summary is; equal summaries have equal arrays."""
        n = int(self._sets.n_open[0])
        whole = {name: getattr(self._sets, name) for name in (*PLACES, "counts")}
        return whole | {name: getattr(self._sets, name)[:n] for name in OPENED}

    def load(self, arrays: dict[str, np.ndarray]) -> None:
        """Become the summary that has these arrays."""
        n = self._sets.n_open[0] = arrays[OPENED[0]].size
        for name in (*PLACES, "counts"):
            getattr(self._sets, name)[:] = arrays[name]
        for name in OPENED:
            getattr(self._sets, name)[:n] = arrays[name]


PLACES, OPENED = ("newest", "older", "oldest"), ("open_lines", "open_types", "open_exponents")


def _aligned(n: int) -> np.ndarray:
    """Return n empty places for lines, aligned to 64 bytes: unaligned, the walk is 5 to 15 % slower."""
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


@inlined
def _walk_from(line, access_type, exponent, sets):
    """Access a line at one number of sets after the other, from 2^(first + exponent) on, until it is the newest of its set."""
    newest, older, oldest, counts = sets.newest, sets.older, sets.oldest, sets.counts
    n_depths, n_oldest = np.uint64(sets.n_depths), np.uint64(sets.n_oldest)
    bins_of_both, not_found = n_depths + n_depths, n_depths - N_NEWEST
    bins = (n_depths if access_type >= PREFETCH else ZERO) + exponent * bins_of_both
    end = np.uint64(sets.n_exponents) * bins_of_both
    mask = (ONE << (np.uint64(sets.first) + exponent)) - ONE
    first_set = mask + ONE - (ONE << np.uint64(sets.first))
    is_noted = False
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
            if last == NOTHING and depth == not_found and not is_noted:
                is_noted = True
                k = sets.n_open[0]
                sets.open_lines[k], sets.open_types[k] = line, access_type
                sets.open_exponents[k] = bins // bins_of_both
                sets.n_open[0] = k + 1
        first_set += mask + ONE
        mask += mask + ONE
        bins += bins_of_both


@kernel(_nrt=False)
def walk(lines, access_types, sets):
    """Access each line at every number of sets."""
    for i in range(lines.size):
        _walk_from(lines[i], access_types[i], ZERO, sets)


@kernel(_nrt=False)
def walk_open(lines, access_types, from_exponents, sets):
    """Access each line at every number of sets from an exponent of its own on."""
    for i in range(lines.size):
        _walk_from(lines[i], access_types[i], np.uint64(from_exponents[i]), sets)
