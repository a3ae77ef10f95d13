"""What an option may be in Python and in a study: any value -> the plain one that parsers read, or one sentence.

``checked`` reads the arguments of a function of ``import nptrace``, a study the values of its tables; both know options by
their names.
"""

import inspect
import os
from collections.abc import Callable, Iterable, Mapping, Set
from concurrent.futures import Executor
from dataclasses import dataclass
from functools import wraps
from operator import index
from pathlib import Path
from typing import Any, TypeVar, cast

from nptrace.ignored_arguments import refuse_ignored
from nptrace.trouble import trouble
from nptrace_base.errors import NptraceError
from nptrace_base.places import Remote
from nptrace_base.records import MAX_SEED

#: Characters of a value that a message repeats.
_SHOWN = 60

_F = TypeVar("_F", bound=Callable[..., Any])


class OptionError(NptraceError):
    """A wrong value of the option ``name``."""

    def __init__(self, name: str, sentence: object) -> None:
        super().__init__(f"{name}: {sentence}")
        self.name = name


@dataclass(frozen=True)
class Kind:
    """A kind of value.

    Attributes
    ----------
    rule : str
        What a value is, as a part of a sentence.
    example : object
        One that is right.
    plain : callable
        Returns a value as the parsers read it; TypeError or ValueError for a value that is none.
    """

    rule: str
    example: Any
    plain: Callable[[Any], Any]

    def read(self, name: str, value: Any) -> Any:
        """Return a value of the option ``name`` as the parsers read it; OptionError if it is wrong."""
        try:
            return self.plain(value)
        except (TypeError, ValueError):
            sentence = f"{shown(value)} is not {self.rule}; write e.g. {name}={self.example!r}"
            raise OptionError(name, sentence) from None


def shown(value: Any) -> str:
    """Return a value for a message: on one line, and not too long."""
    text = " ".join(repr(value).split())
    return text if len(text) <= _SHOWN else f"{text[: _SHOWN - 3]}..."


def _text(value: Any) -> str:
    if not isinstance(value, str):
        raise TypeError
    return str(value)


def _whole(value: Any) -> int:
    """Return a whole number of Python or NumPy; a truth value is none."""
    if isinstance(value, bool):
        raise TypeError
    return index(value)


def _from(least: int, most: int | None = None) -> Callable[[Any], int]:
    def plain(value: Any) -> int:
        number = _whole(value)
        if number < least or (most is not None and number > most):
            raise ValueError
        return number

    return plain


def _flag(value: Any) -> bool:
    is_numpy = getattr(getattr(value, "dtype", None), "kind", "") == "b" and value.shape == ()
    if not (isinstance(value, bool) or is_numpy):
        raise TypeError
    return bool(value)


def _path(value: Any) -> Path | str:
    """Return a text or a path that can name a file."""
    text = os.fspath(value)
    if not isinstance(text, str) or "\0" in text:
        raise TypeError
    os.fsencode(text)
    return text if isinstance(value, str) else Path(text)


def _place(value: Any) -> Remote | Path | str:
    return value if isinstance(value, Remote) else _path(value)


def pixels_text(value: Any) -> str:
    """Return the size of a picture as a text: of (640, 480) ``"640x480"``."""
    if isinstance(value, str):
        return str(value)
    width, height = map(_whole, _items(value))
    return f"{width}x{height}"


def _part(value: Any) -> str:
    if isinstance(value, str):
        return str(value)
    i, n = map(_whole, _items(value))
    return f"{i}/{n}"


def _items(value: Any) -> Iterable[Any]:
    """Return what can be iterated over in an order of its own."""
    if isinstance(value, (str, bytes, bytearray, Mapping, Set, os.PathLike)):
        raise TypeError
    return iter(value)


def _workers(value: Any) -> int | Executor:
    return value if isinstance(value, Executor) else _from(0)(value)


def _scene(value: Any) -> Any:
    from rtrace.scenes.scene import Scene

    return value if isinstance(value, Scene) else str(_path(value))


def _source(value: Any) -> Any:
    from traces.reader import Run

    return value if isinstance(value, Run) else _place(value)


def _text_or_whole(value: Any) -> str | int:
    return _text(value) if isinstance(value, str) else _whole(value)


def _list_of(item: Callable[[Any], Any]) -> Callable[[Any], Any]:
    """Return what reads one value, which stays one, or a list of several."""

    def plain(value: Any) -> Any:
        try:
            return item(value)
        except TypeError:
            return [item(each) for each in _items(value)]

    return plain


def _one_or_more(several: Callable[[Any], Any]) -> Callable[[Any], Any]:
    def plain(value: Any) -> Any:
        if (found := several(value)) == []:
            raise ValueError
        return found

    return plain


def _or_nothing(kind: Kind) -> Kind:
    return Kind(f"{kind.rule}, or None", kind.example, lambda value: None if value is None else kind.plain(value))


def text(example: str) -> Kind:
    """Return the kind of a single text."""
    return Kind("a text", example, _text)


def several(example: Any) -> Kind:
    """Return the kind of a text or a whole number, or a list of them."""
    return Kind("a text or a whole number, or a list of them", example, _list_of(_text_or_whole))


def texts(example: Any) -> Kind:
    """Return the kind of a text or a list of texts."""
    return Kind("a text or a list of texts", example, _list_of(_text))


def whole(least: int, example: int, most: int | None = None) -> Kind:
    """Return the kind of a single whole number."""
    return Kind(f"a whole number from {least}" + (f" to {most}" if most else ""), example, _from(least, most))


def sources_or(what: str, example: Any, is_taken: Callable[[Any], bool]) -> Kind:
    """Return the kind of a run, a path or something else that is taken as it is, or of a list of them."""
    return Kind(what, example, _one_or_more(_list_of(lambda value: value if is_taken(value) else _source(value))))


FLAG = Kind("True or False", True, _flag)
PATH, PLACE = Kind("a path", "file", _path), Kind("a path", "traces", _place)
SCENE_NAME = Kind("the name of a scene or a mesh file", "sponza", lambda value: str(_path(value)))

#: The kinds of options by name; where a function means something else, it says so.
KINDS: dict[str, Kind] = {
    "scenes": Kind("a mesh file, the name of a scene, or a scene", "sponza", lambda value: [_scene(each) for each in value]),
    "sources": Kind("a run, a path or a list of one or more", "traces/sponza-bvh", _one_or_more(_list_of(_source))),
    "summaries": Kind("a path or a list of them", ["1.sum", "2.sum"], _list_of(_path)),
    "run": Kind("a run or its path", "traces/sponza-bvh", _source), "path": PLACE, "out": PLACE, "traces": PLACE,
    "rays": _or_nothing(PATH), "resume": _or_nothing(PATH), "output": _or_nothing(PATH), "kind": _or_nothing(text("curves")),
    "heat": texts(["accesses", "misses"]), "enlarge": _or_nothing(whole(1, 4, 64)), "one_in": whole(1, 8, 16),
    "accel": texts(["kdtree", "bvh"]), "name": texts(["a", "b"]),
    "camera": _or_nothing(texts("eye=1,2,3 at=0,0,0")), "light": _or_nothing(text("0,9,0")),
    "pixels": Kind("a text WxH or two whole numbers", "64x64", pixels_text),
    "part": Kind("a text I/N or two whole numbers", "1/8", _part),
    "order": text("morton"), "kd": text("max_leaf=4"), "bvh": text("binned"), "shadow": text("lit"),
    "shadow_order": text("sign"), "shadow_end": text("stop"), "scheduler": _or_nothing(text("tcp://host:8786")),
    "reads": text("own"), "flush": text("never"), "by": _or_nothing(text("level")), "machine": text("paper"),
    "n": text("paper"), "preset": _or_nothing(text("paper2013")), "target_error": text("2%"),
    "seed": Kind("a whole number from 0 to 2^63 - 1", 1, _from(0, MAX_SEED)),
    "batch": whole(0, 64), "packet": whole(1, 16), "exact_below": whole(0, 10**6),
    "threads": _or_nothing(whole(1, 4)), "workers": Kind("a whole number from 0, or an executor", 2, _workers),
    "bvh_nodes": several([32, 64]), "size": several(["8K", 16384]), "ways": several([1, 2, "full"]),
    "line": several([32, 64]), "policy": texts(["lru", "fifo"]), "prefetch": texts(["none", "traced"]),
    "layout": texts(["stored", "veb"]), "difference": FLAG, "quick": FLAG,
    **dict.fromkeys(("overwrite", "strict", "offline", "three_c", "is_table1", "baselines"), FLAG),
}  # fmt: skip
#: The numbers of a machine.
NUMBER = several([1, 4])


def _not_default(given: Mapping[str, Any], signature: inspect.Signature) -> tuple[dict[str, Any], dict[str, Any]]:
    """Return the arguments of a call that are not their defaults, and the defaults of the function."""
    defaults = {name: each.default for name, each in signature.parameters.items() if each.default is not each.empty}
    return {name: value for name, value in given.items() if name not in defaults or value != defaults[name]}, defaults


def checked(**special: Kind) -> Callable[[_F], _F]:
    """Return a decorator for a function of ``import nptrace``: its arguments are read, each as the kind of its name.

    ``special`` has the kinds of options that mean something else in this function. What the machine refuses, such as a
    file that cannot be written, becomes one sentence too, as in a command.
    """

    def decorate(function: _F) -> _F:
        signature = inspect.signature(function)
        kinds = {name: special.get(name) or KINDS[name] for name in signature.parameters if name != "numbers"}

        @wraps(function)
        def call(*args: Any, **kwargs: Any) -> Any:
            given = signature.bind(*args, **kwargs)
            for name, value in given.arguments.items():
                parameter = signature.parameters[name]
                if parameter.kind is parameter.VAR_KEYWORD:
                    given.arguments[name] = {each: NUMBER.read(each, value[each]) for each in value}
                elif parameter.kind is parameter.VAR_POSITIONAL:
                    given.arguments[name] = tuple(kinds[name].read(name, value))
                elif value is not parameter.default:
                    found = given.arguments[name] = kinds[name].read(name, value)
                    if found == [] and parameter.default not in (None, ()):
                        raise OptionError(name, "it is an empty list; name something, or leave it out")
            refuse_ignored(*_not_default(given.arguments, signature))
            try:
                return function(*given.args, **given.kwargs)
            except OSError as e:
                if (sentence := trouble(e)) is None:
                    raise
                raise NptraceError(sentence) from e

        return cast(_F, call)

    return decorate
