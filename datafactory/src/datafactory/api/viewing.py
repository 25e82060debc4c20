"""A scene to look at: the page and the pictures of ``datafactory view``."""

from __future__ import annotations

from functools import partial
from pathlib import Path

from datafactory.api.asking import (
    Announce,
    Effects,
    FileName,
    MaterialsLike,
    PosesLike,
    Progress,
    RadarLike,
    SceneLike,
    load_scene,
    materials_of,
    order_of,
    silent,
)
from datafactory.frame.chain import SceneSource, StoredSource, illuminated
from datafactory.frame.defaults import DEFAULT_FRAMES
from datafactory.paths.backend import select_variant, set_threads
from datafactory.run.preparation import prepare, prepared_scene
from datafactory.run.stored import stored_paths
from datafactory.scenes.scene import Scene
from datafactory.view.subject import Subject
from shared.dataset.locations import Location, locate
from shared.dataset.writing import write_bytes
from shared.physics.errors import InputError
from shared.processes.defaults import DEFAULT_RADAR

PAGE_SUFFIX = ".html"


def view(
    scene: SceneLike | None,
    out: FileName,
    *,
    paths: FileName | None = None,
    frame: int = 0,
    poses: PosesLike | None = None,
    radar: RadarLike = DEFAULT_RADAR,
    frames: int = DEFAULT_FRAMES,
    seed: int = 0,
    materials: MaterialsLike | None = None,
    rays: int | None = None,
    depth: int | None = None,
    effects: Effects = "all",
    png: bool = False,
    announce: Announce = silent,
    progress: Progress = silent,
) -> tuple[Path, ...]:
    """Write a page that shows a scene, its sensor and the strongest paths of a frame in three dimensions.

    The page is one file and loads nothing. Frame ``frame`` is that of :func:`datafactory.render` with the same
    arguments; its paths are those of every effect, unless ``effects`` says otherwise.

    :param scene: what is looked at; None with ``paths``, whose manifest names it
    :param out: the page, ``.html``
    :param paths: folder of :func:`datafactory.trace`, local or a URI: its paths instead of a new trace
    :param frame: index of the frame, among the poses or in ``paths``
    :param png: write the view of a camera at the sensor and one from above beside the page as well
    :returns: the files written
    :raises InputError: anything wrong with the arguments or their files, before anything is written
    """
    page = Path(out)
    if page.suffix.lower() != PAGE_SUFFIX:
        raise InputError("--out", f"{str(out)!r}", f"a file that ends in {PAGE_SUFFIX}")
    if not page.parent.is_dir():
        raise InputError("--out", f"no folder {page.parent}", "an existing one")
    if paths is None:
        if scene is None:
            raise InputError("--scene", "missing", "a scene file or sionna:NAME, or --paths")
        subject = _traced_now(
            scene, frame, poses, radar, frames, seed, materials, rays, depth, effects, announce, progress
        )
    else:
        subject = _traced_before(scene, locate(paths), frame, radar, materials, announce)
    from datafactory.view.page import view_page

    write_bytes(page, view_page(subject).encode())
    if not png:
        return (page,)
    from datafactory.view.camera import write_pictures

    return (page, *write_pictures(subject, page.parent, page.stem))


def _traced_now(
    scene: SceneLike,
    frame: int,
    poses: PosesLike | None,
    radar: RadarLike,
    frames: int,
    seed: int,
    materials: MaterialsLike | None,
    rays: int | None,
    depth: int | None,
    effects: Effects,
    announce: Announce,
    progress: Progress,
) -> Subject:
    order = order_of(scene, radar=radar, frames=frames, poses=poses, seed=seed, rays=rays, depth=depth, effects=effects)
    prepared = prepare(order, materials_of(materials), announce, partial(progress, "planning"))
    _require_frame(frame, len(prepared.deal))
    dealt = prepared.deal.frame(frame)
    here, pose = prepared.scenes[dealt.scene], dealt.where
    settings = prepared.plans[dealt.scene].settings(order.settings, pose)
    select_variant()
    set_threads(1)
    progress("tracing", 0, 1)
    traced = SceneSource(dealt, here, settings).traced(order.radar)
    progress("tracing", 1, 1)
    return Subject(f"{here.name}, frame {frame}", here, pose, order.radar, illuminated(traced, settings, order.radar))


def _traced_before(
    scene: SceneLike | None,
    folder: Location,
    frame: int,
    radar: RadarLike,
    materials: MaterialsLike | None,
    announce: Announce,
) -> Subject:
    """The frame of a row of stored paths, in the scene that the manifest names, or in ``scene`` where that is it."""
    order = order_of(None, paths=folder, radar=radar)
    stored = stored_paths(order, folder)
    _require_frame(frame, len(stored.places))
    traced = StoredSource(*stored.places[frame], order.settings).traced(order.radar)
    entry = stored.entries[traced.scene_number]
    source = entry.get("source", "") if scene is None else scene
    put_in = entry.get("population", {"populate": None, "seed": 0})
    opened = (
        source if isinstance(source, Scene) else load_scene(source, populate=put_in["populate"], seed=put_in["seed"])
    )
    if opened.content_hash() != entry.get("content_sha256"):
        problem = f"is not the scene in which the paths of {folder} were traced"
        raise InputError(opened.source or opened.name, problem, "the file as it was then, by --scene if it was moved")
    return Subject(
        f"{traced.scene}, frame {frame}",
        prepared_scene(opened, materials_of(materials), announce),
        traced.pose,
        order.radar,
        illuminated(traced, order.settings, order.radar),
    )


def _require_frame(frame: int, frames: int) -> None:
    if not 0 <= frame < frames:
        raise InputError("--frame", f"{frame}", f"0 to {frames - 1}")
