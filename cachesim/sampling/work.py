"""What counting costs: CPU seconds of calls, by the accesses of each -> about how long a larger count takes."""

from collections.abc import Sequence
from typing import NamedTuple


class Rate(NamedTuple):
    """Sums over calls of one kind, of the accesses x and the CPU seconds y of each."""

    n: float = 0.0
    x: float = 0.0
    y: float = 0.0
    xx: float = 0.0
    xy: float = 0.0

    @classmethod
    def of(cls, x: float, y: float) -> "Rate":
        """Return the sums of one call."""
        return cls(1.0, x, y, x * x, x * y)

    def plus(self, other: "Rate") -> "Rate":
        """Return the sums of both."""
        return Rate(*(a + b for a, b in zip(self, other, strict=True)))

    def seconds(self, x: float, n: float) -> float:
        """Return the CPU time of ``n`` calls of ``x`` accesses in all, by a line fitted through the calls so far."""
        spread = self.n * self.xx - self.x**2
        if spread <= 1e-3 * self.n * self.xx:
            return x * self.y / max(self.x, 1.0)  # all of one size
        each = max((self.n * self.xy - self.x * self.y) / spread, 0.0)
        return x * each + n * max((self.y - each * self.x) / self.n, 0.0)


class Work(NamedTuple):
    """What counting units took: tracing and replaying, and from the start to the end of all."""

    tracing: Rate = Rate()
    replaying: Rate = Rate()
    wall_s: float = 0.0

    def plus(self, other: "Work") -> "Work":
        """Return the sums of both."""
        return Work(
            self.tracing.plus(other.tracing), self.replaying.plus(other.replaying), self.wall_s + other.wall_s
        )  # fmt: skip

    def numbers(self) -> list[float]:
        """Return all sums, as a file keeps them."""
        return [*self.tracing, *self.replaying, self.wall_s]

    @classmethod
    def of_numbers(cls, numbers: Sequence[float]) -> "Work":
        """Return what ``numbers`` gave."""
        *rates, wall_s = numbers
        n = len(Rate._fields)
        return cls(Rate(*rates[:n]), Rate(*rates[n:]), wall_s)

    def seconds_of(self, n_accesses: float, n_calls: float) -> float:
        """Return how long it takes to trace and replay so many accesses once, beside what else this machine does."""
        cpu = self.tracing.seconds(n_accesses, n_calls) + self.replaying.seconds(n_accesses, n_calls)
        return cpu * self.wall_s / max(self.tracing.y + self.replaying.y, 1e-9)
