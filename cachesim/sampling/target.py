"""The target error of an estimate: the text of an option -> the half-width that an interval may have."""

import math
import re
from dataclasses import dataclass

from nptrace_base.errors import NptraceError


@dataclass(frozen=True, slots=True)
class Target:
    """Half-width allowed: the larger of ``relative`` times the value and ``absolute``, both as fractions."""

    relative: float
    absolute: float

    def __post_init__(self) -> None:
        for name in ("relative", "absolute"):
            if not 0.0 <= getattr(self, name) < 1.0:
                raise NptraceError(
                    f"a target error of {100 * getattr(self, name):g} % is not below 100 %; write e.g. 2% or 0.05pp"
                )
        if self.relative == self.absolute == 0.0:
            raise NptraceError("a target error of 0 needs the exact run; render the scene and use npcache replay")

    def __str__(self) -> str:
        parts = [f"{100 * self.relative:g}%"] if self.relative else []
        return ",".join(parts + ([f"{100 * self.absolute:g}pp"] if self.absolute else []))

    def part(self, half: float, value: float) -> float:
        """Return a half-width in units of the one allowed for a miss rate of this value."""
        allowed = max(self.relative * value, self.absolute)
        if half == 0.0:
            return 0.0
        return half / allowed if allowed > 0.0 else math.inf


def parse_target(text: str) -> Target:
    """Return the target that a text names: ``2%`` of the value, ``0.05pp`` (points of a rate in per cent), or both."""
    relative = absolute = 0.0
    for part in re.split(r"[,|]", text):
        match = re.fullmatch(r"\s*(\d+(?:\.\d*)?|\.\d+)\s*(%|pp)\s*", part)
        if match is None:
            raise NptraceError(f"{text!r} is not a target error; write e.g. 2%, 0.05pp, or 2%,0.05pp for the wider of both")
        if match[2] == "%":
            relative = float(match[1]) / 100
        else:
            absolute = float(match[1]) / 100
    return Target(relative, absolute)
