"""What a camera at the sensor sees, and the scene from above: one ray a pixel, coloured by material.

A ray's colour is that of the material it meets, dimmed by the angle at which it meets it and paled by distance. There
is no light source and no shadow: the pictures say where things stand and what they are made of, as the radar's model
has them.

The frames of a dataset are seen in the scenes that its manifest names.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from io import BytesIO
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.artist import Artist
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.image import imread, imsave
from matplotlib.lines import Line2D
from matplotlib.patches import Patch
from numpy.typing import NDArray
from pydantic import BaseModel
from scipy.spatial.transform import Rotation

from datafactory.frame.deal import PreparedScene
from datafactory.run.preparation import prepared_scene
from datafactory.scenes.materials.table import RecordedMaterials
from datafactory.scenes.motion import Real
from datafactory.scenes.poses import Pose
from datafactory.scenes.scene import Scene
from datafactory.scenes.traffic.population import recorded
from datafactory.view.strongest import shown_paths
from datafactory.view.subject import KINDS, MOTION, SENSOR, TARGET, Met, Subject, css, material_colour
from shared.dataset import Frame
from shared.dataset.folder import CAMERA, Dataset, camera_path
from shared.dataset.locations import Location, file_size
from shared.dataset.manifest import MANIFEST
from shared.dataset.reading import radar_of
from shared.dataset.writing import atomic, make_folder
from shared.physics.errors import InputError, figure_text
from shared.physics.vectors import dots
from shared.pictures import save_figure
from shared.processes.telling import silent
from shared.radar import validated

Picture = NDArray[np.uint8]

WIDTH, HEIGHT = 960, 420
"""Of the camera's picture [pixels]."""
FIELD_DEG = 100.0
"""Its horizontal field of view: what lies beyond is stretched on a flat picture. Images reach to 116 deg."""
FINER = 2
"""Rays a pixel, along each side: edges are smooth."""
ABOVE_M = (-25.0, 65.0, 45.0)
"""The view from above: from and to how far ahead, and how far to either side."""
ABOVE_PIXELS_A_METRE = 10
FROM_HEIGHT_M = 10_000.0
"""Rays from above start so high over the sensor."""
SKY, GROUND_HAZE = np.array([206.0, 224.0, 240.0]), np.array([236.0, 240.0, 244.0])
HAZE_M = 120.0
"""Colours pale to 1 / e at this distance."""
DARKEST = 0.45
"""Brightness of a surface met at a grazing angle; head on it is 1."""
TURNED = 0.2
"""Neighbouring pixels have an outline between them if their normals differ by more than this, or their materials."""
OUTLINE = 0.72
"""Brightness of an outline."""


def camera_picture(subject: Subject, width: int = WIDTH, height: int = HEIGHT) -> Picture:
    """[height, width, 3] what a pinhole camera at the sensor sees along its boresight; left of it is on the left."""
    half = np.tan(np.radians(FIELD_DEG) / 2.0)
    columns, rows = FINER * width, FINER * height
    left = half * (1.0 - 2.0 * (np.arange(columns) + 0.5) / columns)
    up = half * height / width * (1.0 - 2.0 * (np.arange(rows) + 0.5) / rows)
    ahead = np.stack(np.broadcast_arrays(1.0, left, up[:, None]), axis=-1).reshape(-1, 3)
    direction = ahead / np.linalg.norm(ahead, axis=1, keepdims=True)
    met = subject.caster.cast(np.zeros_like(direction), direction)
    colours = _coloured(subject, met, direction, np.where(np.isfinite(met.distance), met.distance, 0.0))
    return _averaged(_outlined(colours.reshape(rows, columns, 3), met))


def above_picture(
    subject: Subject, area: tuple[float, float, float] = ABOVE_M, pixels_a_metre: float = ABOVE_PIXELS_A_METRE
) -> Picture:
    """[rows, columns, 3] the scene from straight above the sensor, ahead upwards.

    Straight above is along the radar's own z: a pitched sensor tilts the view.

    :param area: from and to how far ahead, and how far to either side [m]
    """
    nearest, farthest, aside = area
    step = 1.0 / (FINER * pixels_a_metre)
    x = np.arange(farthest, nearest, -step) - 0.5 * step
    y = np.arange(aside, -aside, -step) - 0.5 * step
    start = np.stack(np.broadcast_arrays(x[:, None], y, FROM_HEIGHT_M), axis=-1).reshape(-1, 3)
    direction = np.broadcast_to(np.array([0.0, 0.0, -1.0]), start.shape)
    met = subject.caster.cast(start, direction)
    colours = _coloured(subject, met, direction, np.zeros(len(start)))
    return _averaged(_outlined(colours.reshape(len(x), len(y), 3), met))


def _coloured(subject: Subject, met: Met, direction: Real, haze_m: Real) -> Real:
    """[n, 3] colours of rays."""
    palette = np.array([material_colour(mesh.material) for mesh in subject.scene.merged.meshes] or [(0, 0, 0)], float)
    colours = np.broadcast_to(SKY, (len(direction), 3)).copy()
    hit = met.mesh >= 0
    cosine = np.abs(dots(met.normal[hit], direction[hit]))
    bright = palette[met.mesh[hit]] * (DARKEST + (1.0 - DARKEST) * cosine)[:, None]
    clear = np.exp(-haze_m[hit] / HAZE_M)[:, None]
    colours[hit] = clear * bright + (1.0 - clear) * GROUND_HAZE
    return colours


def _outlined(colours: Real, met: Met) -> Real:
    """The same [rows, columns, 3], darker where a surface ends."""
    rows, columns, _ = colours.shape
    normal, mesh = met.normal.reshape(rows, columns, 3), met.mesh.reshape(rows, columns)
    line = np.zeros((rows, columns), dtype=bool)
    for axis in (0, 1):
        turned = np.linalg.norm(np.diff(normal, axis=axis), axis=-1) > TURNED
        edge = turned | (np.diff(mesh, axis=axis) != 0)
        line[tuple(slice(size) for size in edge.shape)] |= edge
    colours[line] *= OUTLINE
    return colours


def _averaged(colours: Real) -> Picture:
    """[rows, columns, 3] bytes, FINER x FINER rays a pixel."""
    rows, columns, _ = colours.shape
    blocks = colours[: rows // FINER * FINER, : columns // FINER * FINER]
    blocks = blocks.reshape(rows // FINER, FINER, columns // FINER, FINER, 3)
    return np.rint(blocks.mean(axis=(1, 3))).clip(0, 255).astype(np.uint8)


def write_pictures(subject: Subject, folder: Path, stem: str) -> tuple[Path, Path]:
    """Write ``STEM-camera.png`` and ``STEM-above.png``, each with title and legend; returns their paths."""
    camera, above = folder / f"{stem}-camera.png", folder / f"{stem}-above.png"
    save_figure(camera_figure(subject), camera, dpi=110)
    save_figure(above_figure(subject), above, dpi=110)
    return camera, above


def camera_figure(subject: Subject) -> Figure:
    """The camera's picture with title, point targets and the legend of materials."""
    figure = Figure(figsize=(10.0, 5.7), layout="constrained")
    axis = figure.subplots()
    draw_camera(axis, camera_picture(subject))
    x, y, z = subject.targets().T
    ahead = x > 0.5
    if ahead.any():
        half = np.tan(np.radians(FIELD_DEG) / 2.0)
        across = 0.5 * WIDTH * (1.0 - y[ahead] / x[ahead] / half)
        down = 0.5 * HEIGHT - 0.5 * WIDTH * z[ahead] / x[ahead] / half
        inside = (across > 0) & (across < WIDTH) & (down > 0) & (down < HEIGHT)
        axis.plot(across[inside], down[inside], "s", markersize=7, markerfacecolor="none", color=css(TARGET))
    axis.set_title(
        f"{figure_text(subject.title)}: what a camera at the sensor sees, {FIELD_DEG:.0f} deg wide", fontsize=10
    )
    _legend(figure, subject, [])
    return figure


def draw_camera(axis: Axes, picture: Picture) -> None:
    """A camera's picture into a figure."""
    axis.imshow(picture, interpolation="antialiased")
    axis.set_axis_off()


def above_figure(subject: Subject) -> Figure:
    """The scene from above with sensor, field of view, motion and the strongest paths."""
    nearest, farthest, aside = ABOVE_M
    figure = Figure(figsize=(8.6, 7.4), layout="constrained")
    axis = figure.subplots()
    axis.imshow(above_picture(subject), extent=(aside, -aside, nearest, farthest), interpolation="antialiased")
    kinds = []
    if subject.table is not None:
        shown = shown_paths(subject.table, subject.caster, subject.targets())
        for path in reversed(shown.paths):
            axis.plot(path.points[:, 1], path.points[:, 0], color=css(KINDS[path.kind]), linewidth=0.6, alpha=0.8)
        kinds = [kind for kind in KINDS if any(path.kind == kind for path in shown.paths)]
    for line in subject.field_of_view():
        axis.plot(line[:, 1], line[:, 0], color=css(SENSOR), linewidth=0.8, linestyle="--")
    for _, (x, y, _), (vx, vy, _) in subject.movers():
        arrow = {"arrowstyle": "->", "color": css(MOTION), "lw": 1.4}
        axis.annotate("", (y + vy, x + vx), (y, x), annotation_clip=True, arrowprops=arrow)
    targets = subject.targets()
    axis.plot(targets[:, 1], targets[:, 0], "o", markersize=5, markerfacecolor="none", color=css(TARGET))
    axis.plot(0.0, 0.0, "^", color=css(SENSOR), markersize=8)
    axis.set(xlim=(aside, -aside), ylim=(nearest, farthest), xlabel="y [m], left > 0", ylabel="x [m], ahead")
    axis.set_aspect("equal")
    axis.set_title(f"{figure_text(subject.title)}: from above; arrows are one second of motion", fontsize=10)
    _legend(figure, subject, kinds)
    return figure


def _legend(figure: Figure, subject: Subject, kinds: list[str]) -> None:
    """Materials of the scene, then kinds of path, below the picture."""
    materials = dict.fromkeys(mesh.material for mesh in subject.scene.merged.meshes)
    entries: list[Artist] = [Patch(color=css(material_colour(name)), label=figure_text(name)) for name in materials]
    entries += [Line2D([], [], color=css(KINDS[kind]), label=kind) for kind in kinds]
    if entries:
        figure.legend(
            handles=entries, loc="outside lower center", ncols=min(7, len(entries)), fontsize=8, frameon=False
        )


class _SceneEntry(BaseModel):
    name: str
    source: str
    content_sha256: str
    population: dict[str, Any] | None = None
    variants: dict[str, str] = {}
    allow_missing: bool = False
    materials: RecordedMaterials = RecordedMaterials()


class _Rendered(BaseModel):
    """What a picture needs of a manifest."""

    scenes: tuple[_SceneEntry, ...] = ()


class Cameras:
    """The scenes of a dataset, each opened when a frame needs it.

    :param scenes: those that were opened before, among them any that no file holds
    :raises InputError: a manifest without what is needed
    """

    def __init__(self, dataset: Dataset, scenes: Sequence[Scene] = ()) -> None:
        self._source = dataset.path / MANIFEST
        self._rendered = validated(_Rendered, dataset.manifest, self._source)
        self._radar = radar_of(dataset.description(), self._source)
        self._given = {scene.content_hash(): scene for scene in scenes}
        self._opened: dict[str, PreparedScene] = {}

    def subject(self, frame: Frame) -> Subject | None:
        """Scene and pose of a frame; None of a frame of point targets.

        :raises InputError: a scene that cannot be opened, or is not what it was
        """
        if frame.kind != "scene":
            return None
        w, x, y, z = frame.sensor_orientation
        yaw, pitch, roll = Rotation.from_quat([w, x, y, z], scalar_first=True).as_euler("ZYX", degrees=True).tolist()
        if math.isnan(frame.time):
            raise InputError(self._source, "its frames do not say when they are", "a dataset made anew")
        pose = Pose(frame.sensor_position, yaw, pitch, roll, frame.sensor_velocity, frame.time)
        return Subject(f"{frame.scene}, frame {frame.frame_id}", self._scene(frame.scene), pose, self._radar)

    def _scene(self, name: str) -> PreparedScene:
        if name not in self._opened:
            entries = {entry.content_sha256: entry for entry in self._rendered.scenes if entry.name == name}
            if len(entries) != 1:
                raise InputError(self._source, f"{len(entries)} scenes named {name!r}", "one")
            (entry,) = entries.values()
            scene = self._given.get(entry.content_sha256) or recorded(vars(entry), entry.source)
            if scene.content_hash() != entry.content_sha256:
                raise InputError(entry.source, "is not the scene that was rendered", "the file as it was then")
            self._opened[name] = prepared_scene(scene, entry.materials.table(), silent)
        return self._opened[name]


def seen(dataset: Dataset, frame: Frame, cameras: Cameras | None) -> Picture | None:
    """What a camera sees of a frame; None where no picture was written with it and none is to be made.

    :raises InputError: a file that is no picture
    """
    if (stored := dataset.camera(frame.frame_id)) is not None:
        try:
            return np.rint(255.0 * imread(BytesIO(stored))[..., :3]).astype(np.uint8)
        except (OSError, ValueError, SyntaxError, IndexError) as error:
            path = camera_path(dataset.path, frame.frame_id)
            raise InputError(path, f"no picture: {error}", "the file as render --camera wrote it") from error
    subject = None if cameras is None else cameras.subject(frame)
    return None if subject is None else camera_picture(subject)


def write_cameras(dataset: Dataset, cameras: Cameras) -> Iterator[Location]:
    """Write the camera pictures of scene frames that have none yet; those of all, one after the other."""
    make_folder(dataset.path / CAMERA)
    for split in dataset.splits:
        for frame in dataset.frames(split, columns=()):
            path = camera_path(dataset.path, frame.frame_id)
            if file_size(path) is None:  # asked first: a subject opens its scene
                subject = cameras.subject(frame)
                if subject is None:
                    continue
                with atomic(path) as partial:
                    imsave(partial, camera_picture(subject), format="png", metadata={"Software": ""})
            yield path
