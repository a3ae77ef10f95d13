"""A run of several parts: the manifest that makes it one, and the files that it names.

    manifest.json              what follows: the footer, and the name, rows, bytes and sha256 of every file
    nodes-<hash>.parquet       one row per tree node
    image-<hash>.png           the picture
    rays-<hash>.parquet        the rays of one part, and
    accesses-<hash>.parquet    their accesses; a pair of files for each part, in the order of the rays

The run exists when its manifest does, and the manifest is written last. A part's rays and rows are numbered from 0; the
manifest has the numbers of its first ray and its first access in the run. Files are named by their content.
"""

import hashlib
import json
import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from itertools import accumulate
from typing import Any

from nptrace_base.places import Place
from traces.footer import Footer, parse_footer
from traces.format import FILES, RunError

MANIFEST = "manifest.json"
#: The newest version of manifests; a run of four files has the version of its footer.
VERSION = 3

_ENDINGS = {"nodes": "parquet", "rays": "parquet", "accesses": "parquet", "image": "png", "colours": "raw", "job": "raw"}
_NAMES = re.compile(rf"({'|'.join(_ENDINGS)})-[0-9a-f]{{32}}\.(parquet|png|raw)")
#: Files that a render makes on its way: what it has finished, and uploads.
_MADE = re.compile(rf"part-\d+-[0-9a-f]{{16}}\.json|\..*\.tmp(\..*)?|.*\.upload|{_NAMES.pattern}")


@dataclass(frozen=True, slots=True)
class FileFacts:
    """A file of a run: its name, the rows of its table (0 if it is none), its bytes and their sha256."""

    name: str
    rows: int
    bytes: int
    sha256: str

    def to_dict(self) -> dict[str, Any]:
        """Return the JSON form."""
        return {"file": self.name, "rows": self.rows, "bytes": self.bytes, "sha256": self.sha256}


def file_facts(what: str, content: Sequence[Any], rows: int = 0) -> FileFacts:
    """Return the facts about a file, ``nodes`` or another of ``_ENDINGS``, with the content of some buffers."""
    digest = hashlib.sha256()
    for piece in content:
        digest.update(piece)
    n_bytes = sum(memoryview(piece).nbytes for piece in content)
    found = digest.hexdigest()
    return FileFacts(f"{what}-{found[:32]}.{_ENDINGS[what]}", rows, n_bytes, found)


@dataclass(frozen=True, slots=True)
class PartFacts:
    """The files of a part."""

    rays: FileFacts
    accesses: FileFacts


@dataclass(frozen=True, slots=True)
class Manifest:
    """The parts of a run, in the order of its rays; ``footer`` is that of the whole run."""

    footer: Footer
    nodes: FileFacts
    image: FileFacts
    parts: Sequence[PartFacts]

    @property
    def first_rays(self) -> list[int]:
        """The number of the first ray of each part."""
        return [0, *accumulate(part.rays.rows for part in self.parts)][:-1]

    @property
    def first_accesses(self) -> list[int]:
        """The row of the first access of each part."""
        return [0, *accumulate(part.accesses.rows for part in self.parts)][:-1]

    @property
    def files(self) -> list[FileFacts]:
        """All files but the manifest."""
        return [self.nodes, self.image, *(file for part in self.parts for file in (part.rays, part.accesses))]

    def to_json(self) -> bytes:
        """Return the text of the file."""
        parts = [
            {"first_ray": ray, "first_access": access, "rays": part.rays.to_dict(), "accesses": part.accesses.to_dict()}
            for ray, access, part in zip(self.first_rays, self.first_accesses, self.parts, strict=True)
        ]
        run = json.loads(self.footer.to_json())
        values = {"format_version": VERSION, "run": run, "nodes": self.nodes.to_dict(), "image": self.image.to_dict()}
        return (json.dumps({**values, "parts": parts}, sort_keys=True, indent=1) + "\n").encode()


def parse_manifest(text: bytes, run: Place) -> Manifest:
    """Return the manifest of the run at a place; RunError if it is no manifest, or its numbers do not agree."""
    where = run / MANIFEST
    try:
        values = json.loads(text)
        version = values["format_version"]
        if version != VERSION:
            raise RunError(f"{where} has format version {version}, and this program reads {VERSION}; render the run again")
        nodes, image = (parse_file(values[name]) for name in ("nodes", "image"))
        parts = [PartFacts(parse_file(part["rays"]), parse_file(part["accesses"])) for part in values["parts"]]
        firsts = [(part["first_ray"], part["first_access"]) for part in values["parts"]]
        footer_text = json.dumps(values["run"]).encode()
    except RunError:
        raise
    except (ValueError, LookupError, TypeError, AttributeError, RecursionError) as e:
        raise _damaged(where, f"{type(e).__name__}: {e}") from e
    footer: Footer = parse_footer(footer_text, where)
    found = Manifest(footer, nodes, image, parts)
    if not parts or firsts != list(zip(found.first_rays, found.first_accesses, strict=True)):
        raise _damaged(where, "the first rays and accesses of its parts are not the sums of the rows before")
    rows = {"n_rays": sum(part.rays.rows for part in parts), "n_accesses": sum(part.accesses.rows for part in parts)}
    rows["n_nodes"] = nodes.rows
    for name, n in rows.items():
        if getattr(footer, name) != n:
            raise _damaged(where, f"its files have {n} rows together, and its {name} is {getattr(footer, name)}")
    return found


def parse_file(values: Mapping[str, Any]) -> FileFacts:
    """Return the facts about a file from JSON; ValueError if they are of another form."""
    facts = FileFacts(values["file"], values["rows"], values["bytes"], values["sha256"])
    numbers = all(type(number) is int and number >= 0 for number in (facts.rows, facts.bytes))
    if not numbers or not _NAMES.fullmatch(facts.name) or not re.fullmatch("[0-9a-f]{64}", facts.sha256):
        raise ValueError(f"{str(facts.name)[:60]!r} is no file of a run")  # nor one of another folder
    return facts


def check_there(manifest: Manifest, run: Place, found: Mapping[str, int]) -> None:
    """Raise RunError, which names it, if a file of a run is not among those found there, with their bytes, or has others."""
    for file in manifest.files:
        if file.name not in found:
            raise RunError(f"{run / file.name} is missing, and the run is made of it; render it again")
        if found[file.name] != file.bytes:
            raise RunError(
                f"{run / file.name} has {found[file.name]} bytes, and the run was written with {file.bytes}; render it again"
            )


def verified(content: bytes, file: FileFacts, where: Place) -> bytes:
    """Return the content of a file; RunError, which names it, if it is not what was written."""
    if len(content) != file.bytes or hashlib.sha256(content).hexdigest() != file.sha256:
        raise RunError(f"{where} has been changed since the run was written (its checksum is wrong); render it again")
    return content


def is_of_run(name: str) -> bool:
    """Return whether a file's name is one that a run, of either form and finished or not, has."""
    return name in (*FILES, MANIFEST) or _MADE.fullmatch(name) is not None


def _damaged(where: Place, reason: str) -> RunError:
    return RunError(f"{where} is damaged ({reason.splitlines()[0]}); render the run again")
