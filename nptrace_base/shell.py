"""A name -> the word with which a shell passes it on, for commands that are printed to be pasted."""

import os
import shlex


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
