"""The numbers of the clock: a machine by name, or number by number. Each preset figure names its source."""

from dataclasses import dataclass, fields, replace

from cachesim.config import CacheConfig
from nptrace_base.errors import NptraceError

#: What each number is, for ``--help`` and messages: (meaning, least, most).
NUMBERS = {
    "hit": ("cycles from the port to the data of a hit", 1, 1 << 20),
    "miss": ("cycles from the port to the data of a miss, when memory is idle", 1, 1 << 20),
    "mshrs": ("lines that may be in flight at a time; a second miss on one of them joins it", 1, 1 << 16),
    "ports": ("requests that the cache takes in a cycle, demand reads first", 1, 64),
    "bandwidth": ("bytes that memory delivers in a cycle; 0: any number", 0, 1 << 20),
    "box": ("cycles of the box or plane test after a read; pipelined", 0, 1 << 20),
    "triangle": ("cycles of the test of one triangle", 0, 1 << 20),
    "every": ("cycles from the start of one triangle's test to the next of the same leaf", 0, 1 << 20),
    "units": ("intersection units, each with one leaf at a time; 0: one for each ray in flight", 0, 1 << 16),
    "rays": ("rays in flight", 1, 1 << 14),
}


@dataclass(frozen=True, slots=True)
class Clock:
    """A machine, in cycles; the fields are those of ``NUMBERS``. ``name`` is its preset, with what was changed."""

    name: str
    hit: int
    miss: int
    mshrs: int
    ports: int
    bandwidth: int
    box: int
    triangle: int
    every: int
    units: int
    rays: int

    def __post_init__(self) -> None:
        for name, (_, least, most) in NUMBERS.items():
            value = getattr(self, name)
            if not least <= value <= most:
                raise NptraceError(f"{name}={value} is out of range: it is {NUMBERS[name][0]}, from {least} to {most}")
        if self.hit > self.miss:
            raise NptraceError(f"hit={self.hit} takes longer than miss={self.miss}: a miss takes at least as long; swap them")

    def with_numbers(self, **numbers: int | None) -> "Clock":
        """Return the machine with other numbers; None leaves one; ``every`` follows ``triangle`` unless it is given."""
        changed = {name: value for name, value in numbers.items() if value is not None and value != getattr(self, name)}
        if "triangle" in changed and numbers.get("every") is None and self.every == self.triangle:
            changed["every"] = changed["triangle"]
        if not changed:
            return self
        name = f"{self.name}, {', '.join(f'{name}={value}' for name, value in changed.items())}"
        return replace(self, name=name, **changed)

    def to_dict(self) -> dict[str, int | str]:
        """Return the numbers by name."""
        return {("clock" if field.name == "name" else field.name): getattr(self, field.name) for field in fields(self)}


@dataclass(frozen=True, slots=True)
class Preset:
    """A machine from a publication, with its cache and where its numbers come from."""

    clock: Clock
    cache: CacheConfig
    source: str


def _preset(name: str, cache: CacheConfig, source: str, **numbers: int) -> Preset:
    triangle = numbers["triangle"]
    usual = {"mshrs": 16, "ports": 1, "bandwidth": 0, "box": 1, "every": triangle, "units": 0, "rays": 1}
    return Preset(Clock(name=name, **(usual | numbers)), cache, source)


_KB = 1024

#: The machines by name; where a source gives no number, the text names ours. One memory latency stands for all levels below
#: the cache.
PRESETS = {
    preset.clock.name: preset
    for preset in (
        _preset(
            "paper", CacheConfig(8 * _KB, 2, 32),
            "Park et al. 2013, eq. 1: hit 1, miss 100; the paper gives no other number: 1 ray, 16 MSHRs, box test 1 and "
            "triangle test 8 are ours",
            hit=1, miss=100, triangle=8,
        ),
        _preset(
            "rtx2060", CacheConfig(64 * _KB, 512, 128),
            "Vulkan-Sim, configs/tested-cfgs/SM75_RTX2060: hit 20, L2 160, 64 MSHRs of the RT unit, box and triangle 8, "
            "4 warps of 32; lines of 128 B, not their sectors",
            hit=20, miss=160, mshrs=64, box=8, triangle=8, every=1, rays=128,
        ),
        _preset(
            "treelet", CacheConfig(64 * _KB, 512, 128),
            "treelet-prefetching-for-rt (Chou et al., MICRO 2023), its configuration: hit 20, L2 160, 256 MSHRs, tests 4, "
            "16 warps of 32",
            hit=20, miss=160, mshrs=256, box=4, triangle=4, every=1, rays=512,
        ),
        _preset(
            "ttp", CacheConfig(32 * _KB, 256, 128),
            "TTP (arXiv 2605.16253), Table III and text: 32 KB fully associative, hit 20, misses of 100 to 300 (here 200), "
            "256 MSHRs, leaf test 8, 4 warps of 32",
            hit=20, miss=200, mshrs=256, box=8, triangle=8, rays=128,
        ),
        _preset(
            "arches", CacheConfig(64 * _KB, 32, 128),
            "Arches, src/arches-v2 (RTX2080-like): hit 20, L2 160, box 12, triangle 22, a triangle a cycle, 64 rays; "
            "256 x 16 MSHRs",
            hit=20, miss=160, mshrs=4096, box=12, triangle=22, every=1, rays=64,
        ),
        _preset(
            "simtrax", CacheConfig(32 * _KB, 1, 64),
            "SimTRaX, samples/configs/default.config: 32 KB, lines of 64 B, 4 banks (here ports), hit 1, memory 100; its "
            "tests are programs: box 8 and triangle 37 (GauTracer's, Table III) are ours",
            hit=1, miss=100, ports=4, box=8, triangle=37, rays=32,
        ),
    )
}  # fmt: skip


def parse_preset(text: str) -> Preset:
    """Return the preset of a name."""
    if text not in PRESETS:
        raise NptraceError(f"there is no machine {text!r}; choose one of {', '.join(PRESETS)}")
    return PRESETS[text]
