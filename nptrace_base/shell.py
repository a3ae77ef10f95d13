"""A name -> the word with which a shell passes it on, for commands that are printed to be pasted."""

import os
import re
import shlex

#: A word of a command line, quotes and all.
_WORD = re.compile(r"(?:\$'(?:\\.|[^'\\])*'|'[^']*'|\"(?:\\.|[^\"\\])*\"|\\.|[^\s'\"\\])+", re.DOTALL)


def word(name: object) -> str:
    """Return a name as an argument: quoted, also where it is no text, and not to be taken for an option."""
    text = str(name)
    if text.startswith("-") and text != "-":
        text = f"./{text}"
    if text.isprintable():
        return shlex.quote(text)
    return "$'" + "".join(map(_escaped, text)) + "'"


def _escaped(character: str) -> str:
    """Return a character as it stands between $' and '."""
    if character in "'\\":
        return f"\\{character}"
    return character if character.isprintable() else "".join(f"\\x{byte:02x}" for byte in os.fsencode(character))


def command_lines(command: str, width: int | None) -> list[str]:
    """Return a command line as lines of at most ``width`` columns that a shell reads as one; words are broken at blanks alone.

    A word of several, in quotes, becomes quoted parts in lines of their own, which the shell joins again.
    """
    if width is None or len(command) <= width:
        return [command]
    lines, line = [], ""
    for word_ in _WORD.findall(command):
        if line and len(line) + 1 + len(word_) + 2 > width:
            lines.append(f"{line} \\")
            line = ""
        line = f"{line} {word_}" if line else word_
        if len(line) + 2 > width and re.fullmatch(r"'[^']*'", line):
            *parts, line = _parts(line[1:-1], width)
            lines += [f"{part}\\" for part in parts]
    return [*lines, line]


def _parts(text: str, width: int) -> list[str]:
    """Return a text in quoted parts, cut behind blanks."""
    parts, part = [], ""
    for piece in re.findall(r"\S*\s*", text):
        if part and len(part) + len(piece) + 3 > width:
            parts.append(f"'{part}'")
            part = ""
        part += piece
    return [*parts, f"'{part}'"]
