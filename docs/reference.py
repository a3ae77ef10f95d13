"""What the program says of itself, as Markdown for the site: every command with its options, and every public name."""

import importlib
import inspect
from collections.abc import Iterator

import click

import cli

PROGRAMS = (cli.nptrace, cli.npcache)
PACKAGES = ("nptrace", "traces", "rtrace", "cachesim")


def commands() -> str:
    """Return a section for each command: its usage, its examples, its options and its lists."""
    return "\n" + "\n".join(line for program in PROGRAMS for line in _of_program(program)) + "\n"


def overview() -> Iterator[tuple[str, str]]:
    """Yield each command, and its first sentence."""
    for program in PROGRAMS:
        context = click.Context(program, info_name=program.name)
        for name in program.list_commands(context):
            command = program.get_command(context, name)
            assert command is not None
            yield f"{program.name} {name}", command.get_short_help_str(limit=200)


def _of_program(program: click.Group) -> Iterator[str]:
    context = click.Context(program, info_name=program.name, **program.context_settings)
    for name in program.list_commands(context):
        command = program.get_command(context, name)
        assert command is not None
        yield from _of_command(command, click.Context(command, info_name=name, parent=context))


def _of_command(command: click.Command, context: click.Context) -> Iterator[str]:
    yield f"\n## {context.command_path}\n"
    yield f"    {context.command_path} {' '.join(command.collect_usage_pieces(context))}\n"
    for paragraph in inspect.cleandoc(command.help or "").split("\n\n"):
        is_verbatim = paragraph.startswith("\b")
        lines = paragraph.replace("\b", "").strip("\n").splitlines()
        yield "\n".join(f"    {line}" for line in lines) if is_verbatim else _text("\n".join(lines))
        yield ""
    for parameter in command.get_params(context):
        record = parameter.get_help_record(context)
        if record and record[1]:
            yield f"- {_code(record[0])}: {_text(record[1])}"
    for title, rows in getattr(command, "_lists", {}).items():
        yield f"\n**{title}**\n"
        yield from (f"- {_code(name)}: {_text(meaning)}" for name, meaning in rows())


def _code(text: str) -> str:
    return f"`{text}`"


def _text(text: str) -> str:
    """Return a help text as Markdown: what would be an element or a link there is meant literally."""
    return text.replace("<", "&lt;").replace("[", "\\[").replace("*", "\\*")


def public_names() -> str:
    """Return a section for each package with its public names, which Sphinx fills in from their docstrings."""
    homes: dict[int, str] = {}  # by object, the name under which it is described: nptrace's come from the other packages
    for package in (*PACKAGES[1:], PACKAGES[0]):
        module = importlib.import_module(package)
        for name in module.__all__:
            homes.setdefault(id(getattr(module, name)), f"{package}.{name}")
    return "\n" + "\n".join(line for package in PACKAGES for line in _of_package(package, homes)) + "\n"


def _of_package(package: str, homes: dict[int, str]) -> Iterator[str]:
    module = importlib.import_module(package)
    yield f"\n## {package}\n\n{_text((module.__doc__ or '').splitlines()[0])}\n"
    for name in module.__all__:
        thing, path = getattr(module, name), f"{package}.{name}"
        if not (inspect.isclass(thing) or inspect.isroutine(thing)):
            yield f"- `{name}`: {thing!r}"
        elif homes[id(thing)] != path:
            yield f"- `{name}`: `{homes[id(thing)]}`, below"
        elif inspect.isclass(thing):
            # Of members those that can be called or are computed: the docstring of the class describes the others.
            members = [each for each, member in vars(thing).items() if not each.startswith("_") and _is_described(member)]
            shown = f"\n   :members: {', '.join(members)}" if members else ""
            yield f"```{{eval-rst}}\n.. autoclass:: {path}{shown}\n```\n"
        else:
            yield f"```{{eval-rst}}\n.. autofunction:: {path}\n```\n"


def _is_described(member: object) -> bool:
    return isinstance(member, property | classmethod | staticmethod) or inspect.isfunction(member)
