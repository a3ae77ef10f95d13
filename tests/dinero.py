"""``python -m tests.dinero PROGRAM [--cases N] [--seed S] [-o FILE]``: replays of random traces beside what DineroIV prints.

PROGRAM is DineroIV of release 7, which you build yourself (its licence keeps it out of this project). Every case is a trace of
1 to 3,000 accesses with an own mix of hot lines, walks, strays, types and sizes, and a cache of random size, line,
associativity, replacement and fetch policy; the statistics block has to be the same to the last byte. A case that differs is
printed with its command, and its trace is kept.
"""

import argparse
import json
import shutil
import subprocess
import sys
import tempfile
from pathlib import Path
from typing import NamedTuple

import numpy as np

from cachesim.config import CacheConfig
from cachesim.replay import replay
from cachesim.report.dinero import dinero_block
from traces.din import RECORD

#: DineroIV's letter -> our name, for replacement and for fetching. Random replacement draws from another generator.
REPLACEMENT = {"l": "lru", "f": "fifo"}
FETCHING = {"d": "traced", "l": "traced", "a": "next-line:always", "m": "next-line:miss", "t": "next-line:tagged"}
#: Below this address DineroIV knows a line again: it looks for a range of 8 MB by its end, 2^32 of the last, which wraps to 0;
#: there every miss counts as compulsory.
_END = (1 << 32) - (1 << 23)

#: Reads, fetches, accesses that start no prefetch, and prefetches; a policy of the cache takes the place of the trace's own.
_TYPES = np.array([0, 2, 3, 0xB])


class Case(NamedTuple):
    """A cache: bytes, ways and bytes of a line; letters of DineroIV's options; how many lines ahead it requests; whether it
    classifies misses; whether the trace is of records, which have sizes, or text, whose accesses are of 4 bytes.

    The size is a power of two; of its lines, those that make no whole set are not used.
    """

    size: int
    ways: int
    line: int
    replacement: str
    fetching: str
    distance: int
    three_c: bool
    is_binary: bool

    def options(self) -> list[str]:
        """Return DineroIV's options."""
        made = {"size": self.size, "assoc": self.ways, "bsize": self.line, "repl": self.replacement, "fetch": self.fetching}
        words = [word for name, value in made.items() for word in (f"-l1-u{name}", str(value))]
        ahead = ["-l1-upfdist", str(self.distance)] if self.fetching in "amt" else []
        return ["-informat", "b" if self.is_binary else "d", *words, *ahead, *(["-l1-uccc"] if self.three_c else [])]

    def block(self, trace: Path) -> str:
        """Return our statistics block."""
        policy = FETCHING[self.fetching] + (f":{self.distance}" if self.fetching in "amt" else "")
        used = self.size // (self.ways * self.line) * (self.ways * self.line)
        config = CacheConfig(used, self.ways, self.line, REPLACEMENT[self.replacement])
        [result] = replay(trace, [config], prefetch=policy, three_c=self.three_c, threads=1)
        return dinero_block(result, prefetch_rows=self.fetching != "d")


def random_case(random: np.random.Generator) -> Case:
    """Return a cache of 1 to 17 ways and up to 128 sets, of any number."""
    ways, line = int(random.integers(1, 18)), int(2 ** random.integers(2, 8))
    size = 1 << (ways * line - 1).bit_length() + int(random.integers(0, 7))
    letters = str(random.choice([*REPLACEMENT])), str(random.choice([*FETCHING]))
    return Case(size, ways, line, *letters, int(random.integers(1, 5)), *map(bool, random.integers(2, size=2)))


def random_trace(random: np.random.Generator, case: Case) -> bytes:
    """Return a trace: hot addresses, walks forward and strays over all of the memory, in random shares."""
    n, n_types = int(random.integers(1, 3000)), 3 if case.fetching in "amt" else 4
    hot = random.integers(0, 1 << 14, int(random.integers(1, 200)))
    walk = np.cumsum(random.integers(0, 64, n))
    places = np.stack([random.choice(hot, n), walk, random.integers(0, _END - 128, n)])
    address = places[random.choice(3, n, p=random.dirichlet([1, 1, 0.2])), np.arange(n)]
    if random.integers(2):
        address = address & ~np.int64(3)  # no access of text spans two lines
    types = random.choice(_TYPES[:n_types], n, p=random.dirichlet([3, 1, 1, 1][:n_types]))
    if not case.is_binary:
        return "".join(f"{kind:x} {where:x}\n" for kind, where in zip(types, address, strict=True)).encode()
    records = np.zeros(n, RECORD)
    records["address"], records["size"], records["label"] = address, random.integers(1, 100, n), types
    # DineroIV sends a prefetch that spans lines to the first alone, and counts it for all (export says so): there is none.
    is_ahead = types == _TYPES[-1]
    records["address"][is_ahead] &= ~np.uint32(3)
    records["size"][is_ahead] = 4
    return records.tobytes()


def printed(program: str, case: Case, trace: Path) -> str:
    """Return the block that DineroIV prints, from the cache's name to the line before its last words."""
    with open(trace, "rb") as file:
        done = subprocess.run([program, *case.options()], stdin=file, capture_output=True, text=True, check=False)
    if done.returncode:
        raise SystemExit(f"{program} {' '.join(case.options())}: {done.stderr.strip()}")
    return done.stdout[done.stdout.index("l1-ucache\n") :].partition("---Execution complete.")[0]


def main() -> None:
    """Compare, print what differs, and count."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("program")
    parser.add_argument("--cases", type=int, default=1000)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("-o", type=Path, help="JSON file of the numbers of cases and of accesses, for docs/correctness.md")
    args = parser.parse_args()
    n_different = n_accesses = 0
    with tempfile.TemporaryDirectory() as folder:
        for number in range(args.cases):
            random = np.random.default_rng([args.seed, number])
            case, trace = random_case(random), Path(folder) / "x.din"
            trace.write_bytes(random_trace(random, case))
            theirs, ours = printed(args.program, case, trace), case.block(trace)
            n_accesses += int(theirs.partition("Demand Fetches")[2].split(maxsplit=1)[0])
            if ours != theirs:
                n_different += 1
                kept = shutil.copy(trace, f"different-{args.seed}-{number}.din")
                print(f"{args.program} {' '.join(case.options())} < {kept}")
                pairs = zip(theirs.splitlines(), ours.splitlines(), strict=False)
                print(*(f"  {a}\n  {b}" for a, b in pairs if a != b), sep="\n", flush=True)
    print(f"{args.cases} cases, {n_different} differ")
    if args.o:
        found = {"cases": args.cases, "seed": args.seed, "demand_accesses": n_accesses, "different": n_different}
        args.o.write_text(json.dumps(found) + "\n", encoding="utf-8")
    sys.exit(n_different > 0)


if __name__ == "__main__":
    main()
