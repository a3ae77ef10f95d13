"""What the user of the running command typed."""

from collections.abc import Sequence

import click
from click.core import ParameterSource

#: Where a command keeps, in its context, its words.
ARGS = "nptrace.args"


def given(*names: str) -> list[str]:
    """Return those of the running command's parameters, by the names of its function, that its user gave, as options."""
    context = click.get_current_context()
    words = {word.partition("=")[0] for word in context.meta.get(ARGS, ())}
    typed = {
        each.name: next((name for name in each.opts if name in words), each.opts[0])
        for each in context.command.params if isinstance(each, click.Option)
    }  # fmt: skip
    usual = (None, ParameterSource.DEFAULT)
    return [
        typed.get(name, "RUN") for name in names
        if context.get_parameter_source(name) not in usual and context.params[name] != ()  # no RUN is typed too
    ]  # fmt: skip


def listing(words: Sequence[str], last: str = "and") -> str:
    """Return words as a part of a sentence: a, b and c."""
    return f" {last} ".join(filter(None, [", ".join(words[:-1]), words[-1]]))
