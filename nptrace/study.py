"""A study in one file: scenes, pictures, trees, caches, machines and policies in TOML -> runs, and rows of all of them.

What is finished is kept: a run that is on disk is not traced again, and the rows of each run, section, layout and policy are
in a file of their own beside the runs, until another version of the program counts. So the same study goes on where it was
stopped.
"""

import hashlib
import inspect
import json
import tomllib
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from datetime import date, time
from functools import cache, partial
from itertools import product
from pathlib import Path
from typing import TYPE_CHECKING, Any

import nptrace
from nptrace import plans, values
from nptrace.kept_runs import kept_runs
from nptrace.plans import listed
from nptrace.progress import Progress
from nptrace.scene_options import load_scenes, parse_tree, tree_params
from nptrace.values import OptionError
from nptrace_base.errors import NptraceError
from nptrace_base.places import place
from nptrace_base.source_files import digest_of
from traces.reader import Run, open_run

if TYPE_CHECKING:
    from rtrace.render import Shooting

#: The keys outside the tables, and what they are when left out.
TOP = {"out": "traces"}
#: The options of packets and of shadow rays, in the order of ``Shooting``.
KNOBS = "packet", "shadow", "shadow_order", "shadow_end"
#: The options of render whose lists make every combination, and those that a file has in another form than Python.
COMBINED = ("scenes", "pixels", "order", "batch", *KNOBS, "kd", "bvh")
KINDS = {"pixels": values.text("64x64"), "scenes": values.SCENE_NAME}
#: The options of replay that choose no caches, policies or layouts.
HOW = ("three_c", "reads", "flush")
#: The tables of stage 2, and the keys of their functions that a study has no use for.
SECTIONS, NOT_OF_A_STUDY = ("replay", "sweep", "time"), (
    "sources", "traces", "threads", "workers", "scheduler", "by", "numbers"
)  # fmt: skip


@dataclass(frozen=True)
class Study:
    """A study, checked: the values of every table, with the defaults of the functions of ``import nptrace``."""

    path: Path
    out: Path
    render: Mapping[str, Any]
    sections: Mapping[str, Mapping[str, Any]]

    @property
    def pictures(self) -> "list[tuple[Shooting, dict[str, dict[str, Any]]]]":
        """Every combination of the options that may be lists: rays, and the parameters of each tree."""
        from rtrace.camera import parse_size
        from rtrace.render import Shooting

        of = self.render
        trees, nodes = listed("accel", of["accel"], parse_tree), listed("bvh_nodes", of["bvh_nodes"], str)
        found: dict[str, tuple[Shooting, dict[str, dict[str, Any]]]] = {}
        for pixels, order, batch, *knobs, kd, bvh in product(*(_several(of[name]) for name in COMBINED[1:])):
            shooting = Shooting(*parse_size(pixels), order, batch, of["seed"] if order == "random" else 0, *knobs)
            for kind, given in tree_params(trees, kd, bvh, nodes).items():
                shooting.check_format(kind)
                found.setdefault(repr((shooting, kind, given)), (shooting, {kind: given}))
        return list(found.values())


def read_study(path: Path) -> Study:
    """Read and check a study; NptraceError names the file and the line of what is wrong."""
    try:
        text = path.read_text(encoding="utf-8-sig")
        found = tomllib.loads(text)
    except OSError as e:
        raise NptraceError(f"cannot read {path}: {e.strerror}; name a study in TOML, as in `nptrace run --help`") from e
    except (ValueError, RecursionError) as e:  # not TOML, not UTF-8, or thousands of brackets
        raise NptraceError(f"{path} is not valid TOML: {e}; see https://toml.io, or `nptrace run --help`") from e
    where = _Lines(path, text)
    tables = {name: value for name, value in found.items() if isinstance(value, dict)}
    plain = {name: value for name, value in found.items() if name not in tables}
    where.check_names("", found, [*TOP, "render", *SECTIONS])
    for name in ("render", *SECTIONS):
        if name in plain:
            raise where.error("", name, f"{name} is a table; write [{name}] and its keys below it")
    if "render" not in tables:
        raise NptraceError(f'{path} has no table [render], which names the scenes; write [render] and scenes = ["sponza"]')
    if not set(tables) & {*SECTIONS}:
        raise NptraceError(f"{path} asks for no rows; add one of the tables {', '.join(f'[{name}]' for name in SECTIONS)}")
    render = _checked(where, "render", tables["render"], {**_defaults("render"), "scenes": ()})
    sections = {
        name: _checked(where, name, tables[name], {**_defaults(name), **(dict.fromkeys(_numbers()) if name == "time" else {})})
        for name in SECTIONS if name in tables
    }  # fmt: skip
    given = _checked(where, "", {name: value for name, value in found.items() if name in TOP}, TOP)
    with where.of("", "out"):
        out = place(given["out"])
    if not isinstance(out, Path):
        raise where.error("", "out", f"out is {out}, and a study keeps rows beside its runs; name a folder of this machine")
    study = Study(path, out, render, sections)
    _try(where, study)
    return study


def _numbers() -> tuple[str, ...]:
    from cachesim.clock.parameters import NUMBERS

    return tuple(NUMBERS)


def _defaults(function: str) -> dict[str, Any]:
    """Return the options of a function of ``import nptrace``, and their defaults."""
    left_out = (*NOT_OF_A_STUDY, "out", "name", "overwrite", "rays") if function == "render" else NOT_OF_A_STUDY
    parameters = inspect.signature(getattr(nptrace, function)).parameters.values()
    return {each.name: each.default for each in parameters if each.name not in left_out}


def _checked(where: "_Lines", table: str, given: Mapping[str, Any], defaults: Mapping[str, Any]) -> dict[str, Any]:
    """Return the values of a table: each of the kind of its option, or a list of such where every combination is made."""
    where.check_names(table, given, defaults)
    found = dict(defaults)
    for name, value in given.items():
        key = f"{table}.{name}" if table else name
        if value == [] and name != "camera":
            raise where.error(table, name, f"{key} is an empty list; name something, or leave the key out")
        kind = values.NUMBER if table == "time" and name in _numbers() else KINDS.get(name) or values.KINDS[name]
        is_several = name in COMBINED and isinstance(value, list)
        try:
            found[name] = [kind.plain(each) for each in value] if is_several else kind.plain(value)
        except (TypeError, ValueError):
            rule = kind.rule.replace("True or False", "true or false").replace(", or None", "")
            rule += ", or a list of such" * (name in COMBINED)
            way = f"write e.g. {name} = {_toml(kind.example)}"
            raise where.error(table, name, f"{key} is {_toml(value)}, and not {rule}; {way}") from None
    return found


def _toml(value: Any) -> str:
    """Return a value about as the file has it, for a message."""
    if isinstance(value, bool):
        return str(value).lower()
    return str(value) if isinstance(value, date | time) else values.shown(value)


def _try(where: "_Lines", study: Study) -> None:
    """Read every option, so that nothing is wrong when the work begins."""
    from rtrace.camera import parse_camera, parse_point, parse_size
    from rtrace.render import Shooting

    of = study.render
    if not of["scenes"]:
        raise where.error("render", "", '[render] names no scene; write e.g. scenes = ["sponza"]')
    tries: dict[str, Callable[[Any], object]] = {
        "pixels": parse_size, "camera": parse_camera, "order": lambda order: Shooting(order=order),
        "batch": lambda batch: Shooting(batch=batch), **{name: partial(_with_knob, name) for name in KNOBS},
        "kd": lambda text: tree_params([], text, "sweep", ["32"]),
        "bvh": lambda text: tree_params([], "", text, ["32"]), "light": parse_point,
        "accel": lambda text: listed("accel", text, parse_tree),
        "bvh_nodes": lambda text: tree_params([], "", "sweep", listed("bvh_nodes", text, str)),
    }  # fmt: skip
    for name, attempt in tries.items():
        for value in _several(of[name]):
            with where.of("render", name):
                attempt(value)
    with where.of("render", "bvh_nodes"):
        pictures = study.pictures
    if "time" in study.sections and any(shooting.packet > 1 for shooting, _ in pictures):
        raise where.error("render", "packet", "on the clock every ray reads for itself; leave out [time], or write packet = 1")
    for name in study.sections:
        with where.of(name, ""):
            _plan(name, study.sections[name])
        _check_how(where, name, study.sections[name])


def _with_knob(name: str, value: Any) -> "Shooting":
    from rtrace.shooting import Shooting

    return Shooting(**{name: value})


def _plan(name: str, values: Mapping[str, Any]) -> Any:
    """Return the caches or machines, the prefetch policies and the layouts of a section."""
    given = {key: value for key, value in values.items() if key not in HOW and value is not None}
    plan: Callable[..., Any] = getattr(plans, f"{name}_plan")
    return plan(**given)


def _check_how(where: "_Lines", name: str, values: Mapping[str, Any]) -> None:
    """Check the options of ``HOW``, each of which has one value."""
    from cachesim.flush import FLUSHES
    from cachesim.reads import READS

    for key, known in (("three_c", (True, False)), ("reads", READS), ("flush", FLUSHES)):
        with where.of(name, key):
            if key in values and values[key] not in known:
                text = ", ".join(map(str, known)).replace("True, False", "true or false")
                raise NptraceError(f"{key}: {values[key]!r} is not one of {text}")


def _several(value: Any) -> list[Any]:
    return [] if value is None else list(value) if isinstance(value, (list, tuple)) else [value]


class _Lines:
    """The lines of a study's keys, for its messages."""

    def __init__(self, path: Path, text: str) -> None:
        self._path, self._lines = path, text.split("\n")

    def of(self, table: str, name: str) -> "_Blame":
        """Return a context in which an error is of this key, or of the option that it names."""
        return _Blame(self, table, name)

    def error(self, table: str, name: str, sentence: str) -> NptraceError:
        """Return the error of a key: with its line, or that of its table."""
        return NptraceError(f"{self._path}, line {self._line(table, name)}: {sentence}")

    def check_names(self, table: str, given: Mapping[str, Any], known: Any) -> None:
        """Raise NptraceError for a key that a table does not have."""
        for name in given:
            if name not in known:
                of = f"[{table}] has" if table else "a study has"
                raise self.error(table, name, f"{of} no {name!r}; its keys are {', '.join(known)}")

    def _line(self, table: str, name: str) -> int:
        """Return the line where a key begins: the first lines of a file, up to the end of its value, are a TOML that has it.

        Of a key that is not there it is the line of its table.
        """
        first, of_table = 1, 0
        for n in range(1, len(self._lines) + 1):
            try:
                read = tomllib.loads("\n".join(self._lines[:n]))
            except ValueError:  # within a value of several lines
                continue
            inside = read.get(table, {}) if table else read
            if name and isinstance(inside, dict) and name in inside:
                return first
            if not of_table and table in read:
                of_table = first
            first = n + 1
        return of_table or 1


class _Blame:
    def __init__(self, lines: _Lines, table: str, name: str) -> None:
        self._lines, self._table, self._name = lines, table, name

    def __enter__(self) -> None:
        return None

    def __exit__(self, kind: object, error: BaseException | None, traceback: object) -> None:
        if isinstance(error, NptraceError):
            name = error.name if isinstance(error, OptionError) else self._name
            key = "" if name in str(error) else f"{self._table}.{name}: "
            raise self._lines.error(self._table, name, f"{key}{error}") from error


def run_study(study: Study, *, threads: int | None = None) -> list[dict[str, Any]]:
    """Make the runs that are not there, and the rows that are not there; return all rows, each with its ``section``."""
    from nptrace.studies import rendered

    of = study.render
    scenes = load_scenes(_several(of["scenes"]), of["strict"], of["offline"], _several(of["camera"]), of["light"])
    jobs = [(scene, shooting, params) for scene in scenes for shooting, params in study.pictures]
    plans = {name: _plan(name, values) for name, values in study.sections.items()}
    n_parts = sum(len(list(_parts(name, plan))) for name, plan in plans.items())
    rows: list[dict[str, Any]] = []
    found = kept_runs(study.path, study.out, jobs)
    with Progress(len(jobs) * (1 + n_parts)) as bar:
        for (scene, shooting, params), (path, is_kept) in zip(jobs, found.items(), strict=True):
            if is_kept:
                bar.job(path.name)
            else:
                rendered([scene], params, shooting, study.out, bar, threads=threads)
            run = open_run(path)
            for name, plan in plans.items():
                for layout, prefetches in _parts(name, plan):
                    part = _Part(study, run, name, plan[0], layout, prefetches)
                    rows += part.rows(bar, threads)
    return rows


def _parts(name: str, plan: Any) -> Iterator[tuple[str, list[str]]]:
    """Yield the layout and the prefetch policies of the parts that are kept one by one; the clock times policies together."""
    _, prefetches, layouts = plan
    for layout in layouts:
        yield from [(layout, prefetches)] if name == "time" else ((layout, [each]) for each in prefetches)


@cache
def _code() -> str:
    """Return a digest of all that makes rows: what another version has counted is counted again, and stands beside none."""
    from nptrace import studies

    return digest_of([Path(studies.__file__)])


@dataclass(frozen=True)
class _Part:
    """Some rows of one run, which are kept in a file once they are complete."""

    study: Study
    run: Run
    name: str
    of: Any  # caches, or machines
    layout: str
    prefetches: Sequence[str]

    def rows(self, bar: Progress, threads: int | None) -> list[dict[str, Any]]:
        import pyarrow as pa
        import pyarrow.parquet as pq

        from nptrace_base.atomic import whole_file
        from nptrace_base.records import write_parquet
        from traces.identity import COLUMNS

        section = self.study.sections[self.name]
        how = {name: section[name] for name in HOW if section.get(name)}
        asked = [self.run.footer.to_json().decode(), str(self.run.path), self.name, repr(self.of), self.layout,
                 [*self.prefetches], how, _code()]  # fmt: skip
        path = self.study.out / f"study-{hashlib.sha256(json.dumps(asked).encode()).hexdigest()[:16]}.parquet"
        if path.exists():
            bar.job(self.run.name)
            try:
                found = pq.read_table(path).to_pylist()
            except (pa.ArrowException, OSError) as e:
                raise NptraceError(f"{path} cannot be read as a part of a study; delete it, and it is made again") from e
            return found
        made = [{**each.run_columns, "section": self.name, **each.others} for each in self._made(bar, threads, how)]
        with whole_file(path) as temporary:
            write_parquet(made, temporary, COLUMNS)
        return made

    def _made(self, bar: Progress, threads: int | None, how: dict[str, Any]) -> Iterator["_Row"]:
        from nptrace.studies import replayed, swept, timed

        runs, layouts = [self.run], [self.layout]
        results: Sequence[Any]
        if self.name == "replay":
            results = replayed(runs, self.of, self.prefetches, layouts, bar, threads=threads, **how)
        elif self.name == "sweep":
            results = swept(runs, self.of, self.prefetches, layouts, bar, threads=threads)
        else:
            results = timed(runs, self.of.configs, self.of.clocks, self.prefetches, layouts, bar, threads=threads)
        return (_Row(each.identity.to_dict(), each.to_dict()) for each in results)


@dataclass(frozen=True)
class _Row:
    run_columns: dict[str, Any]
    values: dict[str, Any]

    @property
    def others(self) -> dict[str, Any]:
        return {name: value for name, value in self.values.items() if name not in self.run_columns}
