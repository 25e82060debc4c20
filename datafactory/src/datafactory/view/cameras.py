"""Camera pictures of a dataset's frames, from the scenes that its manifest names."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from io import BytesIO

import numpy as np
from matplotlib.image import imread, imsave
from numpy.typing import NDArray
from pydantic import BaseModel, ValidationError
from scipy.spatial.transform import Rotation

from datafactory.frame.prepared import PreparedScene
from datafactory.run.preparation import prepared_scene
from datafactory.scenes.materials.table import MaterialTable, load_materials
from datafactory.scenes.poses import Pose
from datafactory.scenes.readers.open import open_scene
from datafactory.scenes.scene import Scene
from datafactory.view.camera import camera_picture
from datafactory.view.subject import Subject
from shared.dataset import Frame
from shared.dataset.folder import CAMERA, Dataset, camera_path
from shared.dataset.locations import Location, file_size
from shared.dataset.manifest import MANIFEST
from shared.dataset.reading import radar_of
from shared.dataset.writing import atomic, make_folder
from shared.physics.errors import InputError
from shared.radar import first_validation_error


class _SceneEntry(BaseModel):
    name: str
    source: str
    content_sha256: str


class _Rendered(BaseModel):
    """What a picture needs of a manifest."""

    scenes: tuple[_SceneEntry, ...] = ()


class Cameras:
    """The scenes of a dataset, each opened when a frame needs it.

    :param scenes: those that were opened before, among them any that no file holds
    :param materials: that decide the colours
    :raises InputError: a manifest without what is needed
    """

    def __init__(self, dataset: Dataset, scenes: Sequence[Scene] = (), materials: MaterialTable | None = None) -> None:
        self._source = dataset.path / MANIFEST
        try:
            self._rendered = _Rendered.model_validate(dataset.manifest)
        except ValidationError as error:
            raise InputError(self._source, *first_validation_error(error)) from error
        self._radar = radar_of(dataset.description(), self._source)
        self._given = {scene.content_hash(): scene for scene in scenes}
        self._materials = materials or load_materials()
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
            entries = [entry for entry in self._rendered.scenes if entry.name == name]
            if len(entries) != 1:
                raise InputError(self._source, f"{len(entries)} scenes named {name!r}", "one")
            (entry,) = entries
            scene = self._given.get(entry.content_sha256) or open_scene(entry.source)
            if scene.content_hash() != entry.content_sha256:
                raise InputError(entry.source, "is not the scene that was rendered", "the file as it was then")
            self._opened[name] = prepared_scene(scene, self._materials, lambda line: None)
        return self._opened[name]


def stored_picture(dataset: Dataset, frame_id: int) -> NDArray[np.uint8] | None:
    """The camera picture of a frame that was written with it; None where there is none.

    :raises InputError: a file that is no picture
    """
    if (picture := dataset.camera(frame_id)) is None:
        return None
    try:
        return np.rint(255.0 * imread(BytesIO(picture))[..., :3]).astype(np.uint8)
    except (OSError, ValueError, SyntaxError, IndexError) as error:
        raise InputError(
            camera_path(dataset.path, frame_id), f"no picture: {error}", "the file as render --camera wrote it"
        ) from error


def seen(dataset: Dataset, frame: Frame, cameras: Cameras | None) -> NDArray[np.uint8] | None:
    """What a camera sees of a frame; None where no picture was written with it and none is to be made."""
    picture = stored_picture(dataset, frame.frame_id)
    if picture is None and cameras is not None and (subject := cameras.subject(frame)) is not None:
        picture = camera_picture(subject)
    return picture


def write_cameras(dataset: Dataset, cameras: Cameras) -> Iterator[Location]:
    """Write the camera pictures of all scene frames that have none yet, one after the other."""
    make_folder(dataset.path / CAMERA)
    for split in dataset.splits:
        for frame in dataset.frames(split, columns=()):
            path, subject = camera_path(dataset.path, frame.frame_id), cameras.subject(frame)
            if subject is None or file_size(path) is not None:
                continue
            with atomic(path) as partial:
                imsave(partial, camera_picture(subject), format="png", metadata={"Software": ""})
            yield path
