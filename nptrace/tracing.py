"""The functions of ``import nptrace`` that trace scenes: ``render`` and ``estimate``; those that read runs are in ``api``."""

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Literal, TypedDict, Unpack, overload

from nptrace.plans import Given, estimate_plan, listed
from nptrace.progress import Progress
from nptrace.results import Results
from nptrace.values import checked, pixels_text
from nptrace_base.engines import engine_of
from nptrace_base.errors import NptraceError
from nptrace_base.places import Place, place
from traces.reader import Run, open_run

if TYPE_CHECKING:
    from concurrent.futures import Executor

    from rtrace.scenes.scene import Scene

#: The size of a picture, "640x480" or (640, 480).
Pixels = str | tuple[int, int]


class RenderOptions(TypedDict, total=False):
    """The options of ``render`` that do not decide how many runs it makes."""

    pixels: Pixels
    light: str | None
    order: str
    batch: int
    seed: int
    packet: int
    shadow: str
    shadow_order: str
    shadow_end: str
    kd: str
    bvh: str
    rays: Path | str | None
    out: Place | str
    name: str | Sequence[str]
    overwrite: bool
    workers: "int | Executor"
    scheduler: str | None
    threads: int | None
    strict: bool
    offline: bool


@overload
def render(  # type: ignore[overload-overlap]
    scene: "str | Path | Scene", /, *, accel: Literal["kdtree", "bvh"], camera: str | None = None,
    bvh_nodes: Literal[32, 64] = 32, **options: Unpack[RenderOptions],
) -> Run: ...  # fmt: skip


@overload
def render(
    *scenes: "str | Path | Scene", accel: Given = (), camera: str | Sequence[str] | None = None, bvh_nodes: Given = 32,
    **options: Unpack[RenderOptions],
) -> list[Run]: ...  # fmt: skip


@checked()
# Many parameters: one per option of the command, as callers write them and help() lists them.
def render(
    *scenes: "str | Path | Scene", accel: Given = (), pixels: Pixels = "128x128", camera: str | Sequence[str] | None = None,
    light: str | None = None, order: str = "scanline", batch: int = 1, seed: int = 0, packet: int = 1, shadow: str = "lit",
    shadow_order: str = "sign", shadow_end: str = "stop", kd: str = "", bvh: str = "sweep", bvh_nodes: Given = 32,
    rays: Path | str | None = None, out: Place | str = "traces", name: str | Sequence[str] = (), overwrite: bool = False,
    workers: "int | Executor" = 0, scheduler: str | None = None, threads: int | None = None, strict: bool = False,
    offline: bool = False,
) -> Run | list[Run]:  # fmt: skip
    """Trace pictures of scenes, as ``nptrace render`` does, and return the runs, which are on disk.

    Parameters
    ----------
    scenes : str, Path or Scene
        Mesh files, names that ``nptrace scenes`` lists, or scenes (``rtrace.scene_from_triangles``).
    accel : str or list
        Trees, ``"kdtree"`` and ``"bvh"``; both by default.
    pixels : str or (int, int)
        Width and height of the picture, ``"640x480"`` or ``(640, 480)``.
    camera : str or list
        One, or several for several runs, each as ``"eye=1,2,3 at=0,0,0 up=0,1,0 fov=45"`` in units of the scene and degrees;
        by default the scene's or a fitted one.
    light : str, optional
        Position of the point light, ``"x,y,z"`` in units of the scene; by default the scene's or a fitted one.
    order : str
        Order of the pixels: ``"scanline"``, ``"tile"``, ``"morton"``, ``"hilbert"`` or ``"random"``.
    batch : int
        Primary rays traced before their shadow rays; 0 for all of them.
    seed : int
        Seed of the random order, from 0 to 2^63 - 1.
    packet : int
        Rays that walk the tree as one: 1, 4, 16 or 64, of a square of pixels.
    shadow, shadow_order, shadow_end : str
        Which pixels send a shadow ray (``"lit"``, ``"hit"``, ``"all"``), which child it searches first (``"sign"``,
        ``"cheaper"``), and what is read after its hit (``"stop"``, ``"drain"``).
    kd, bvh : str
        Builders and their parameters, ``"max_leaf=4,c_trav=1"`` or ``"binned"``, as the command's help lists them.
    bvh_nodes : int or list
        Bytes of a BVH's node, 32 or 64; both for a run of each.
    rays : Path, optional
        Parquet file of rays to trace instead of a picture's (``rtrace.ray_file``).
    out : Path
        Folder for the runs, or an address such as s3://bucket/folder.
    name : str or list
        Names of the runs, one per scene and camera; by default they tell what a run is of.
    overwrite : bool
        Replace a run of other content that has the name.
    workers : int or Executor
        Trace parts of the picture in so many processes, or on the workers of an executor of ``concurrent.futures``.
    scheduler : str, optional
        Trace them on the workers of a Dask cluster.
    threads : int, optional
        By default, the number of processors; the results do not depend on it.
    strict : bool
        Refuse a mesh with bad triangles instead of leaving them out.
    offline : bool
        Never download a scene.

    Returns
    -------
    Run or list of Run
        A Run if one scene, one tree and at most one camera are given, each as a single value; else a list.

    Raises
    ------
    NptraceError
        A value is wrong, a scene is not found or cannot be read, or a run of other content has the name.
    """
    from nptrace.scene_options import check_run_names, load_scenes, own_rays, parse_tree, tree_params
    from nptrace.studies import rendered
    from rtrace.camera import ORDERS, parse_size
    from rtrace.ray_file import RayFile
    from rtrace.render import Shooting

    trees, sizes = listed("accel", accel, parse_tree), listed("bvh_nodes", bvh_nodes, str)
    cameras = [camera] if isinstance(camera, str) else list(camera or ())
    names = [name] if isinstance(name, str) else list(name)
    if not scenes:
        raise NptraceError("no scene is given; name a mesh file or a scene, e.g. render('sponza')")
    if order not in ORDERS:
        raise NptraceError(f"order: {order!r} is not one of {', '.join(ORDERS)}")
    check_run_names(names, len(scenes) * max(len(cameras), 1))
    shooting: Shooting | RayFile
    sides = parse_size(pixels_text(pixels))
    shooting = picture = Shooting(*sides, order, batch, seed, packet, shadow, shadow_order, shadow_end)
    if rays is not None:
        shooting = own_rays(Path(rays), picture, [*cameras, *([light] if light else [])])
    params = tree_params(trees, kd, bvh, sizes)
    seen = load_scenes([str(each) if isinstance(each, Path) else each for each in scenes], strict, offline, cameras, light)
    folder = place(out)
    with engine_of(workers, scheduler) as engine, Progress(len(seen) * len(params)) as bar:
        made = rendered(
            seen, params, shooting, folder, bar, names=names, overwrite=overwrite, threads=threads, engine=engine
        )  # fmt: skip
    runs = [open_run(folder / each.identity.run) for each in made]  # whose path is for printing alone
    is_single = len(runs) == 1 and isinstance(accel, str) and (camera is None or isinstance(camera, str))
    return runs[0] if is_single else runs


@checked()
# Many parameters: one per option of the command, as callers write them and help() lists them.
def estimate(
    *scenes: "str | Path | Scene", accel: Given = (), size: Given = "8K", ways: Given = "1", line: Given = "32",
    policy: Given = "lru", layout: Given = "stored", is_table1: bool = False, target_error: str = "2%,0.05pp",
    exact_below: int = 100_000_000, resume: Path | str | None = None, pixels: Pixels = "2048x2048",
    camera: str | Sequence[str] | None = None, light: str | None = None, order: str = "scanline", batch: int = 1,
    seed: int = 0, kd: str = "", bvh: str = "sweep", bvh_nodes: Given = 32, threads: int | None = None,
    strict: bool = False, offline: bool = False,
) -> Results:  # fmt: skip
    """Estimate the miss rates of large pictures from part of their rays, as ``npcache estimate`` does; no run is written.

    Parameters
    ----------
    scenes, accel, pixels, camera, light, order, batch, kd, bvh, bvh_nodes, threads, strict, offline
        As those of ``render``.
    size, ways, line, policy, layout
        As those of ``replay``; lru alone can be estimated.
    is_table1 : bool
        Take the four caches of Table I.
    target_error : str
        Half-width allowed for every miss rate: relative (``"2%"``), in percentage points (``"0.05pp"``), or the wider of both.
    exact_below : int
        Runs of up to so many predicted accesses are counted exactly.
    resume : Path, optional
        Keep the counts of one run in this file, and continue from it if it exists.
    seed : int
        Of the sample, and of the random order.

    Returns
    -------
    Results
        One row per run, with its caches in ``cells``, whose rates are fractions with their ``half_width``.

    Raises
    ------
    NptraceError
        A value is wrong, or a scene is not found or cannot be read.
    """
    from cachesim.report import estimate_tables
    from nptrace.estimates import Sampling, estimate_scenes
    from nptrace.scene_options import PictureOptions, Trees, load_scenes, parse_tree

    configs, _, layouts = estimate_plan(size, ways, line, policy, layout, is_table1=is_table1)
    cameras = [camera] if isinstance(camera, str) else list(camera or ())
    trees = Trees(listed("accel", accel, parse_tree), kd, bvh, tuple(listed("bvh_nodes", bvh_nodes, str)))
    sampling = Sampling(target_error, exact_below, threads, None if resume is None else Path(resume))
    if not scenes:
        raise NptraceError("no scene is given; name a mesh file or a scene, e.g. estimate('sponza')")
    named = [str(each) if isinstance(each, Path) else each for each in scenes]
    seen = load_scenes(named, strict, offline, cameras, light)
    found = [result for *_, result in estimate_scenes(
        seen, trees, configs, PictureOptions(pixels_text(pixels), order, batch, seed), sampling, layouts
    )]  # fmt: skip
    return Results(
        "estimate", estimate_tables.records(found, "json"), lambda: estimate_tables.tables(found),
        lambda: estimate_tables.flat(found),
    )  # fmt: skip
