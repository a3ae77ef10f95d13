"""Scene and tree -> a run of several parts: traced by workers or in this process, in an object store or on disk.

A part is a stretch of the picture's chunks, whatever the number of workers, so the same command gives the same files. Each
part is written when it is traced, and a record of it last; the manifest, when all parts are there. A render that is started
again takes the parts that have records; of two at a time, the second takes the run that the first has completed.
"""

import hashlib
import json
import re
import time
import zlib
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import suppress
from dataclasses import asdict, dataclass, replace
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np

from nptrace_base.engines import Engine
from nptrace_base.errors import NptraceError
from nptrace_base.places import Place, older, publish, sizes
from nptrace_base.source_files import digest_of
from rtrace.chunk import Chunk
from rtrace.counts import RunCounts
from rtrace.ray_file import CHUNK as RAYS_OF_CHUNK
from rtrace.ray_file import RayFile, ray_chunks
from rtrace.rays import Rays
from rtrace.render import CameraAndLight, Piece, RunFacts, Shooting, chunks, footer_of, pieces, png, shot, summary
from rtrace.scenes.scene import Scene
from rtrace.shared_arrays import laid_out, mapped
from rtrace.trees.tree import BVH_NODE, BVH_PAIR, KD_NODE, Tree, node_table
from traces.footer import Footer
from traces.format import BOX, FILES, LEAF, PREFETCH, PRIMARY, SHADOW, SPLIT, RunError
from traces.manifest import (
    MANIFEST,
    FileFacts,
    Manifest,
    PartFacts,
    check_there,
    file_facts,
    is_of_run,
    parse_file,
    parse_manifest,
    verified,
)
from traces.node_formats import NODE_FORMATS
from traces.part_writer import PartWriter, encoded_table
from traces.reader import open_run
from traces.writer import looks_like_run, node_schema

#: Pixels, or rays of a file, of a part: some million accesses, and 127 parts of a picture at 4K.
PART = 1 << 16


@dataclass(frozen=True)
class PartJob:
    """All that a worker needs to trace any part of a run; small, and free of arrays.

    ``file`` has the arrays of the tree, and of the rays where ``shooting`` is None; ``key`` tells the records of this run's
    parts from others, and ``code`` is a digest of what traces them.
    """

    place: Place
    footer: Footer
    view: CameraAndLight
    shooting: Shooting | None
    file: FileFacts
    key: str
    code: str


@dataclass(frozen=True)
class Finished:
    """A part that is written: its files, with the colours of its pixels, and its counts."""

    files: Mapping[str, FileFacts]
    counts: RunCounts

    def to_json(self) -> bytes:
        """Return the text of the record."""
        files = {name: file.to_dict() for name, file in self.files.items()}
        return json.dumps({"files": files, "counts": asdict(self.counts)}, sort_keys=True).encode()


# Many parameters: those of render.render, in whose place it is called, and two of its own.
def render_parts(
    scene: Scene,
    tree: Tree,
    shooting: Shooting | RayFile,
    path: Place,
    *,
    threads: int = 2,
    tool_version: str = "",
    progress: Callable[[int], object] = lambda pixels: None,
    on_write: Callable[[], object] = lambda: None,
    engine: Engine | None = None,
    part: int = PART,
) -> RunFacts:
    """Trace a picture, or the rays of a file, part by part, and write the run at ``path``; parameters as ``render.render``.

    Parameters
    ----------
    engine : Engine, optional
        The workers; without it this process traces with ``threads``.
    part : int
        Pixels of a part, at least; a chunk is not cut.
    """
    own = footer_of(scene, tree, shooting, tool_version)
    footer = replace(own, n_nodes=len(tree.nodes))
    rays = shooting if isinstance(shooting, RayFile) else None
    content = laid_out(*_arrays(tree, rays))
    file = file_facts("job", content)
    asked = [footer.to_json().decode(), file.sha256, part, _code()]
    key = hashlib.sha256(json.dumps(asked).encode()).hexdigest()[:16]
    picture = None if rays is not None else shooting
    job = PartJob(path, footer, CameraAndLight(scene.camera, scene.light), picture, file, key, _code())  # type: ignore[arg-type]
    if isinstance(shooting, Shooting):
        parts = _cut(pieces(shooting), max(part // shooting.packet, 1))
    else:
        parts = _cut(_ray_pieces(shooting), part)
    began, needed = time.time(), set[str]()  # until the manifest is written
    try:
        if path.exists() and not looks_like_run(path):
            raise RunError(f"{path} exists and is not a run; choose another --out or remove it")
        found = _finished_before(job)
        needed.update(*(_on_the_way(number, each, key) for number, each in found.items()))
        for number in found:
            progress(_n_shaded(parts[number], shooting))
        tasks = [(job, number, parts[number]) for number in range(len(parts)) if number not in found]
        if engine is None:
            results: Any = ((i, trace_part(*task, (tree, rays), threads)) for i, task in enumerate(tasks))
        else:
            if tasks and sizes(path).get(file.name) != file.bytes:
                publish(path / file.name, *content)
            needed |= {file.name} if tasks else set()
            there = replace(job, place=path.absolute() if isinstance(path, Path) else path)  # workers may be in other folders
            results = engine.results(trace_part, [(there, *task[1:]) for task in tasks])
        for i, finished in results:
            _, number, stretch = tasks[i]
            found[number] = finished
            needed |= _on_the_way(number, finished, key)
            progress(_n_shaded(stretch, shooting))
        on_write()
        return _completed(job, tree, parts, [found[number] for number in range(len(parts))], began)
    except (OSError, RunError) as e:
        if (made := _made_meanwhile(job, needed)) is not None:
            return made
        if isinstance(e, RunError):
            raise
        raise RunError(f"cannot write {path}: {e.strerror or e}; choose another --out") from e


@cache
def _code() -> str:
    """Return a digest of all that determines the rows of a part."""
    return digest_of([Path(__file__)])


def _cut(pieces: Iterator[Piece], part: int) -> list[list[Piece]]:
    """Return the pieces of each part."""
    parts: list[list[Piece]] = []
    n = part
    for piece in pieces:
        if n >= part:
            parts.append([])
            n = 0
        parts[-1].append(piece)
        start, stop, _ = piece
        n += stop - start
    return parts


def _ray_pieces(file: RayFile) -> Iterator[Piece]:
    yield from ((low, min(low + RAYS_OF_CHUNK, file.n_rays), None) for low in range(0, file.n_rays, RAYS_OF_CHUNK))


def _n_shaded(stretch: Sequence[Piece], shooting: Shooting | RayFile) -> int:
    starts = range(shooting.n_rays + 1) if isinstance(shooting, RayFile) else shot(shooting)[1]
    return int(sum(starts[stop] - starts[start] for start, stop, which in stretch if which != PRIMARY))


def trace_part(
    job: PartJob, number: int, stretch: Sequence[Piece], given: tuple[Tree, RayFile | None] | None = None, threads: int = 1
) -> Finished:
    """Trace a part, write its files and then its record; what a worker does.

    Parameters
    ----------
    given : (Tree, RayFile or None), optional
        The tree and the rays where this process has them; else they are mapped from the job's file.

    Raises
    ------
    RunError
        This process has other sources than the one that asks, so its rows might not be those of the other parts.
    """
    if job.code != _code():
        raise RunError(
            f"cannot trace a part of {job.place}: a worker has other sources of nptrace than the command; "
            "install the same version for all workers"
        )
    tree, rays = given or _given(job)
    counts, writer, colours = RunCounts(), PartWriter(), zlib.compressobj(1)
    squeezed = []
    traced: Iterator[Chunk]
    if job.shooting is None:
        assert rays is not None
        traced = ray_chunks(tree, rays, threads, [start for start, _, _ in stretch])
    else:
        traced = chunks(tree, job.view, job.shooting, threads, stretch)
    try:
        for chunk in traced:
            counts.add(chunk)
            writer.append(chunk.rays, chunk.accesses)
            if chunk.is_shaded:
                squeezed.append(colours.compress(chunk.colours.tobytes()))
        encoded = writer.encoded(lambda n_rays, n_accesses: replace(job.footer, n_rays=n_rays, n_accesses=n_accesses))
    except BaseException:
        writer.abandon()
        raise
    contents = {**encoded, "colours": (b"".join([*squeezed, colours.flush()]), 0)}
    files = {}
    for what, (content, n_rows) in contents.items():
        files[what] = file_facts(what, [content], n_rows)
        publish(job.place / files[what].name, content)
    finished = Finished(files, counts)
    publish(job.place / _record(number, job.key), finished.to_json())
    return finished


def _record(number: int, key: str) -> str:
    return f"part-{number}-{key}.json"


def _on_the_way(number: int, finished: Finished, key: str) -> set[str]:
    """Return the names of the files of a part that are deleted when the run is complete."""
    return {_record(number, key), finished.files["colours"].name}


def _finished_before(job: PartJob) -> dict[int, Finished]:
    """Return the parts that an earlier render of this run has finished, and whose files are there."""
    there, found = sizes(job.place), {}
    for name in there:
        if match := re.fullmatch(rf"part-(\d+)-{job.key}\.json", name):
            with suppress(OSError, ValueError, LookupError, TypeError):
                values = json.loads((job.place / name).read_bytes())
                files = {what: parse_file(each) for what, each in values["files"].items()}
                if all(there.get(file.name) == file.bytes for file in files.values()):
                    finished = Finished(files, RunCounts(**values["counts"]))
                    _colours(job, finished)
                    found[int(match[1])] = finished
    return found


def _completed(
    job: PartJob, tree: Tree, parts: Sequence[Sequence[Piece]], finished: Sequence[Finished], began: float
) -> RunFacts:  # fmt: skip
    """Write what the run has once, and then its manifest; delete what was there for the workers, and what is of other runs.

    These are the run before it, and what killed renders of others have left: what was not written since this one began.
    """
    where, counts = job.place, sum((each.counts for each in finished), RunCounts())
    fields = SPLIT if NODE_FORMATS[tree.kind].tree == "kdtree" else BOX
    nodes, n_nodes = encoded_table(node_schema(job.footer, fields), node_table(tree), job.footer)
    image = png(_picture(job, parts, finished))
    of_run = {"nodes": file_facts("nodes", [nodes], n_nodes), "image": file_facts("image", [image])}
    footer = replace(
        job.footer, n_rays=counts.n_rays, n_accesses=counts.n_accesses, image_sha256=of_run["image"].sha256
    )  # fmt: skip
    manifest = Manifest(footer, **of_run, parts=[PartFacts(each.files["rays"], each.files["accesses"]) for each in finished])
    publish(where / of_run["nodes"].name, nodes)
    publish(where / of_run["image"].name, image)
    there = sizes(where)
    check_there(manifest, where, there)  # another render may have deleted some
    before: set[str] = set()
    with suppress(OSError, RunError):
        before = {file.name for file in parse_manifest((where / MANIFEST).read_bytes(), where).files}
    text = manifest.to_json()
    publish(where / MANIFEST, text)
    ours = set().union(*(_on_the_way(number, each, job.key) for number, each in enumerate(finished)))
    left = set(filter(is_of_run, older(where, began)))
    done_with = {job.file.name, *FILES, *ours, *before} & there.keys() | left
    for name in done_with - {MANIFEST, *(file.name for file in manifest.files)}:
        (where / name).unlink(missing_ok=True)
    n_bytes = len(text) + sum(file.bytes for file in manifest.files)
    return summary(footer, where, counts, n_nodes, n_bytes)


def _made_meanwhile(job: PartJob, needed: set[str]) -> RunFacts | None:
    """Return the summary of this very run if another render of it has completed it, and deleted files that this one needs."""
    with suppress(OSError, NptraceError):
        there = sizes(job.place).keys()
        run = open_run(job.place)
        own = {name: getattr(job.footer, name) for name in ("n_rays", "n_accesses", "image_sha256")}
        if needed <= there or replace(run.footer, **own) != job.footer:
            return None
        counts = RunCounts(run.footer.n_rays, run.n_accesses)
        rays = run.columns("rays", ["type", "prim"])
        is_shadow, has_met = rays["type"] == SHADOW, rays["prim"] >= 0
        counts.n_shadow, counts.n_shadowed = int(is_shadow.sum()), int((is_shadow & has_met).sum())
        counts.n_hits = int(has_met.sum()) - counts.n_shadowed
        for (kinds,) in run.batches(("kind",)):
            counts.n_prefetches += int(np.count_nonzero(kinds == PREFETCH))
            counts.n_leaves += int(np.count_nonzero(kinds == LEAF))
        for name in needed & there:
            (job.place / name).unlink(missing_ok=True)
        return summary(run.footer, job.place, counts, run.n_nodes, run.n_bytes)
    return None


def _colours(job: PartJob, part: Finished) -> np.ndarray:
    """Return the colours of a part's pixels, (n, 3) uint8; RunError if they are not what was written."""
    where, file = job.place / part.files["colours"].name, part.files["colours"]
    return np.frombuffer(zlib.decompress(verified(where.read_bytes(), file, where)), np.uint8).reshape(-1, 3)


def _picture(job: PartJob, parts: Sequence[Sequence[Piece]], finished: Sequence[Finished]) -> np.ndarray:
    """Return the picture, (height, width, 3) uint8, from the colours of the parts; of rays from a file there is none."""
    width, height = (1, 1) if job.shooting is None else (job.shooting.width, job.shooting.height)
    picture = np.zeros((height * width, 3), np.uint8)
    for stretch, part in zip(parts, finished, strict=True):
        colours = _colours(job, part)
        if job.shooting is None:
            picture[:] = colours[-1]
            continue
        order, starts = shot(job.shooting)
        shaded = [order[starts[start] : starts[stop]] for start, stop, which in stretch if which != PRIMARY]
        picture[np.concatenate([*shaded, order[:0]])] = colours
    return picture.reshape(height, width, 3)


_WORDS = ("nodes", "pairs")  # arrays of structures, which are stored as words


def _arrays(tree: Tree, rays: RayFile | None) -> tuple[dict[str, np.ndarray], dict[str, Any]]:
    """Return the arrays of a job's file, and what else it holds."""
    arrays = {name: value for name, value in tree._asdict().items() if isinstance(value, np.ndarray)}
    arrays |= {name: arrays[name].view(np.uint32) for name in _WORDS if name in arrays}
    facts: dict[str, Any] = {"kind": tree.kind, "max_level": int(tree.max_level), "params": tree.params}
    if rays is not None:
        arrays |= {f"rays.{name}": value for name, value in rays.rays._asdict().items()} | {"any_hit": rays.any_hit}
        facts |= {"source": rays.source, "sha256": rays.sha256}
    return arrays, facts


def _given(job: PartJob) -> tuple[Tree, RayFile | None]:
    """Return the tree and the rays of a job's file, mapped."""
    arrays, facts = mapped(job.place / job.file.name, job.file)
    types = {"nodes": KD_NODE if facts["kind"] == "kdtree" else BVH_NODE, "pairs": BVH_PAIR}
    of_tree = {name: arrays[name] for name in Tree._fields if name in arrays}
    of_tree |= {name: arrays[name].view(types[name]) for name in _WORDS if name in arrays}
    tree = Tree(**of_tree, kind=facts["kind"], max_level=facts["max_level"], params=facts["params"])
    if job.shooting is not None:
        return tree, None
    rays = Rays(*(arrays[f"rays.{name}"] for name in Rays._fields))
    return tree, RayFile(facts["source"], facts["sha256"], rays, arrays["any_hit"])
