"""Options that several commands share, and the types of their values."""

import os
import re
from collections.abc import Callable, Sequence
from dataclasses import dataclass, fields
from functools import wraps
from typing import TYPE_CHECKING, Any

import click

from nptrace.groups import BadInput
from nptrace.typed import listing
from nptrace_base.errors import NptraceError

if TYPE_CHECKING:
    from cachesim.config import CacheConfig


SIZE_HELP = "Cache sizes, and ranges of their ends and the powers of two between, e.g. 8K,16K or 4K..64K"
WAYS_HELP = "Associativity: numbers of ways and ranges, e.g. 1,2,full or 1..16"


def gathered(name: str, kind: type) -> Callable[[Callable[..., Any]], Callable[..., Any]]:
    """Return a decorator that hands the options named as the fields of a dataclass over as one argument, ``name``."""

    def decorate(function: Callable[..., Any]) -> Callable[..., Any]:
        @wraps(function)
        def command(**kwargs: Any) -> Any:
            values = {field.name: kwargs.pop(field.name) for field in fields(kind) if field.name in kwargs}
            return function(**{name: kind(**values)}, **kwargs)

        return command

    return decorate


class Choice(click.Choice):
    """One of some words, in any case."""

    def __init__(self, words: Sequence[str]) -> None:
        super().__init__(words, case_sensitive=False)


class ListOf(click.ParamType):
    """A comma-separated list; every item goes through a function that raises NptraceError on a bad one."""

    def __init__(self, name: str, item: Any) -> None:
        self.name, self._item = name, item

    def convert(self, value: Any, param: click.Parameter | None, ctx: click.Context | None) -> Any:
        """Return the list that a text names."""
        if not isinstance(value, str):
            return value
        try:
            return [self._item(text) for text in value.split(",")]
        except NptraceError as e:
            raise BadInput(f"{param.opts[0]}: {e}" if param else str(e)) from e


class _Seed(click.ParamType):
    """A seed, which a column of a Parquet file holds."""

    name = "integer"

    def convert(self, value: Any, param: click.Parameter | None, ctx: click.Context | None) -> int:
        """Return the number that a text names."""
        from nptrace_base.records import MAX_SEED

        text = str(value).strip()
        if not (re.fullmatch("[0-9]{1,19}", text) and int(text) <= MAX_SEED):
            raise BadInput(f"--seed: {text!r} is not a whole number from 0 to 2^63 - 1; write e.g. --seed 1")
        return int(text)


def seed_option(help: str) -> Any:
    """Return the option for the seed of something random."""
    return click.option("--seed", type=_Seed(), default=0, show_default=True, help=help)


def joined(ctx: click.Context, param: click.Parameter, values: tuple[list[list[Any]], ...]) -> list[Any]:
    """Join the lists of a repeated option whose items are lists, as ranges are, without repetitions."""
    return list(dict.fromkeys(item for value in values for items in value for item in items))


def merged(ctx: click.Context, param: click.Parameter, values: tuple[list[Any], ...]) -> list[Any]:
    """Join the lists of a repeated option, without repetitions."""
    return list(dict.fromkeys(item for value in values for item in value))


def list_option(*names: str, item: Any, metavar: str, default: str, help: str, callback: Callable[..., Any] = merged) -> Any:
    """Return an option that may be repeated and takes comma-separated lists."""
    return click.option(
        *names, type=ListOf(metavar, item), metavar=metavar, multiple=True, default=[default], show_default=True,
        callback=callback, help=help,
    )  # fmt: skip


def size_option() -> Any:
    """Return the option for the sizes of caches, single ones or powers of two in ranges."""

    def parse(text: str) -> list[int]:
        from cachesim.grid import parse_sizes

        return parse_sizes(text)

    return list_option(
        "--size", item=parse, metavar="SIZES", default="8K", callback=joined,
        help=f"{SIZE_HELP}.",
    )  # fmt: skip


def ways_option() -> Any:
    """Return the option for the associativity of caches, single numbers of ways or ranges."""

    def parse(text: str) -> tuple[str, ...]:
        from cachesim.grid import parse_ways_range

        return parse_ways_range(text)

    return list_option(
        "--ways", "--assoc", item=parse, metavar="WAYS", default="1",
        help=f"{WAYS_HELP}.",
    )  # fmt: skip


def policy_option(*taken: str, help: str) -> Any:
    """Return the option for the replacement policies of a command that takes these."""

    def parse(text: str) -> str:
        from cachesim.config import POLICIES

        if text.lower() not in POLICIES:
            raise NptraceError(f"{text!r} is not a replacement policy; choose {listing(taken, 'or')}")
        return text.lower()

    return list_option("--policy", item=parse, metavar="POLICIES", default="lru", help=help)


@dataclass(frozen=True)
class Caches:
    """The values of ``cache_options``."""

    size: list[int]
    ways: list[tuple[str, ...]]
    line: list[int]
    policy: list[str]
    seed: int = 0

    def configs(self) -> "list[CacheConfig]":
        """Return every combination."""
        from cachesim.grid import caches

        return caches(self.size, self.ways, self.line, self.policy, self.seed)


def threads_option() -> Any:
    """Return the option for the number of threads."""
    return click.option(
        "--threads", type=click.IntRange(1), default=os.cpu_count() or 1, show_default="all processors",
        help="Threads to use; the results do not depend on it.",
    )  # fmt: skip


def workers_options(command: Any) -> Any:
    """Add the options for processes, and for the workers of a cluster."""
    scheduler = click.option(
        "--scheduler", metavar="ADDRESS",
        help="Use the workers of a Dask cluster, which must find the same files under the same paths.",
    )  # fmt: skip
    workers = click.option(
        "--workers", type=click.IntRange(0), default=0, metavar="N",
        help="Use N processes instead of threads, each for parts of a run; the results are the same.",
    )  # fmt: skip
    return workers(scheduler(command))
