"""A scene to look at: the page and the pictures of ``datafactory view``."""

from __future__ import annotations

from pathlib import Path

from datafactory.api.asking import materials_of, order_of, scenes_of
from datafactory.api.options import OrderOptions, SceneOptions, ViewOptions
from datafactory.api.turns import in_turn
from datafactory.frame.chain import SceneSource, StoredSource, narrowed
from datafactory.paths.backend import set_threads
from datafactory.run.preparation import prepare, prepared_scene
from datafactory.scenes.materials.table import RecordedMaterials
from datafactory.scenes.scene import Scene
from datafactory.scenes.traffic.population import recorded
from datafactory.view.subject import Subject
from shared.dataset.locations import Location, locate
from shared.dataset.manifest import MANIFEST
from shared.dataset.writing import make_folder, require_folder, write_bytes
from shared.physics.errors import InputError
from shared.processes.declared import common, taking
from shared.radar import validated

PAGE_SUFFIX = ".html"


@taking(ViewOptions)
@in_turn
def view(asked: ViewOptions) -> tuple[Path, ...]:
    """Write a page that shows a scene, its sensor and the strongest paths of a frame in three dimensions.

    The page is one file and loads nothing. The frame is that of :func:`datafactory.render` with the same arguments; its
    paths are those of every effect, unless ``effects`` says otherwise.

    :returns: the files written
    :raises InputError: anything wrong with the arguments or their files, before anything is written
    """
    page = Path(asked.out)
    if page.suffix.lower() != PAGE_SUFFIX:
        raise InputError("--out", f"{str(asked.out)!r}", f"a file that ends in {PAGE_SUFFIX}")
    require_folder(page.parent, "--out", "a file in a folder")
    subject = _traced_now(asked) if asked.paths is None else _traced_before(asked, locate(asked.paths))
    from datafactory.view.page import view_page

    make_folder(page.parent)
    write_bytes(page, view_page(subject).encode())
    if not asked.png:
        return (page,)
    from datafactory.view.camera import write_pictures

    return (page, *write_pictures(subject, page.parent, page.stem))


def _traced_now(asked: ViewOptions) -> Subject:
    order = order_of(common(OrderOptions, asked, scenes=asked.scene))
    job = prepare(order, materials_of(asked.materials), asked.announce).job
    _require_frame(asked.frame, len(job.deal))
    dealt = job.deal.frame(asked.frame)
    here, pose = job.scenes[dealt.scene], dealt.where
    set_threads(1)
    asked.progress("tracing", 0, 1)
    traced = SceneSource(dealt, here, order.of_scenes).traced(order.radar)
    asked.progress("tracing", 1, 1)
    title = f"{here.name}, frame {asked.frame}"
    _, paths = narrowed(traced, order.of_scenes, order.radar)
    return Subject(title, here, pose, order.radar, paths)


def _traced_before(asked: ViewOptions, folder: Location) -> Subject:
    """The frame of a row of stored paths, in the scene that the manifest names, or in that one from elsewhere."""
    # How the scene is read and what it is made of is for what is shown beside the paths. All effects are those traced.
    ours = {**vars(SceneOptions()), "scenes": None, "effects": "auto" if asked.effects == "all" else asked.effects}
    order = order_of(common(OrderOptions, asked, **ours))
    assert order.traced is not None  # by its paths
    _require_frame(asked.frame, len(order.stored))
    # Nothing is drawn of the frame's seed: a view has no noise.
    traced = StoredSource(order.stored[asked.frame], 0, order.of_scenes).traced(order.radar)
    _, paths = narrowed(traced, order.of_scenes, order.radar)
    entry = order.traced.scenes[traced.scene_number]
    (given,) = scenes_of(entry.get("source", "") if asked.scene is None else asked.scene, asked, order.seed)
    opened = given if isinstance(given, Scene) else recorded(entry, str(given))
    if opened.content_hash() != entry.get("content_sha256"):
        problem = f"is not the scene in which the paths of {folder} were traced"
        raise InputError(opened.source or opened.name, problem, "the file as it was then, by --scene if it was moved")
    were = validated(RecordedMaterials, entry.get("materials", {}), folder / MANIFEST)
    materials = were.table() if asked.materials is None else materials_of(asked.materials)
    return Subject(
        f"{traced.scene}, frame {asked.frame}",
        prepared_scene(opened, materials, asked.announce),
        traced.pose,
        order.radar,
        paths,
    )


def _require_frame(frame: int, frames: int) -> None:
    if not 0 <= frame < frames:
        raise InputError("--frame", f"{frame}", f"0 to {frames - 1}")
