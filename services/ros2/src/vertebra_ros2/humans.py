"""Humans: the faces that a camera of the fleet sees, for ROS nodes that know ROS4HRI.

The topics of a face come with the face and go with it. Nothing is subscribed to, so that no camera
and no perception runs for it, before a ROS node reads the list of faces or a topic of a face.
"""

from __future__ import annotations

import asyncio
import time
from collections.abc import Callable
from typing import Any, Final

from vertebra.bus import Delivery
from vertebra.errors import VertebraError
from vertebra.messages import Expressions, Face, Faces, Header, HeadPoses, Image, Message
from vertebra.ros2 import humans
from vertebra.ros2.driver import Writer
from vertebra.ros2.mapping import Record, to_record
from vertebra.ros2.mapping.parts import header
from vertebra.ros2.qos import Qos
from vertebra.service import MessageReader
from vertebra_ros2.carried import Kit
from vertebra_ros2.crops import Crops
from vertebra_ros2.routes import Humans

SILENT_AFTER_S: Final = 2.0
"""So long after the last list of faces all of them are gone."""
_QOS: Final = Qos(depth=1)
"""As `hri_face_detect` offers them."""
_TRANSFORM_QOS: Final = Qos(depth=100)


class OutboundHumans:
    """From the keys of one camera's faces to `/humans/faces/...` and `/tf`."""

    def __init__(self, kit: Kit, route: Humans) -> None:
        self._kit = kit
        self._route = route
        self._tracked = kit.transport.writer(humans.TRACKED, humans.TRACKED_TYPE, _QOS)
        self._transforms: Writer | None = None
        if route.head_poses:
            self._transforms = kit.transport.writer(
                humans.TRANSFORMS, humans.TRANSFORMS_TYPE, _TRANSFORM_QOS
            )
        self._writers: dict[int, dict[str, Writer]] = {}
        self._seen = Faces(faces=(), image_width=0, image_height=0)
        self._heard_s = 0.0
        self._crops = Crops()
        self._work: dict[str, asyncio.Task[None]] = {}
        self._count = kit.messages.labels(route.ros, route.key, "outbound")

    def look(self) -> None:
        """Carry while a ROS node reads of faces; let go those of which nothing comes any more."""
        route = self._route
        graph = self._kit.transport.graph
        read = {
            name
            for name in graph.topics()
            if name.startswith(f"{humans.FACES}/") and graph.readers(name)
        }
        self._follow("faces", route.key, Faces, self._faces, wanted=bool(read))
        self._follow("expressions", route.expressions, Expressions, self._expressions,
                     wanted=bool(read))  # fmt: skip
        self._follow("poses", route.head_poses, HeadPoses, self._poses, wanted=bool(read))
        cropped = any(name.endswith("/cropped") for name in read)
        self._follow("image", route.image, Image, self._image, wanted=cropped)
        if self._writers and time.monotonic() > self._heard_s + SILENT_AFTER_S:
            self._lose_all()
        self._report(self._problem())

    def _problem(self) -> str:
        readers = self._kit.transport.graph.readers(humans.TRACKED)
        problem = self._kit.clash(readers, humans.TRACKED_TYPE)
        if not problem and self._tracked.mismatch:
            problem = f"a subscriber does not hear us: its {self._tracked.mismatch} differs"
        if not problem and self._route.head_poses and self._writers and not self._frame_id():
            problem = (
                "head poses have no frame: the camera's images do not name theirs; "
                "add 'frame_id: ...' to the route"
            )
        return problem

    def _report(self, problem: str) -> None:
        self._kit.report(f"humans {self._route.key}", problem)

    def _follow(
        self,
        what: str,
        key: str,
        message_type: type[Any],
        came: Callable[[Any, Header], None],
        *,
        wanted: bool,
    ) -> None:
        if wanted and key and what not in self._work:
            work = self._carry(key, message_type, came)
            self._work[what] = self._kit.context.tasks.create_task(work, name=f"{what} to ROS")
        elif not wanted and what in self._work:
            self._work.pop(what).cancel()
            if what == "faces":
                self._lose_all()

    async def _carry(
        self, key: str, message_type: type[Message], came: Callable[[Any, Header], None]
    ) -> None:
        context = self._kit.context
        async with context.bus.subscribe(key, Delivery.latest()) as subscription:
            async for received in MessageReader(subscription, context.codecs, message_type):
                try:
                    came(received.message, received.header)
                except VertebraError as error:
                    self._kit.refused.inc()
                    self._report(str(error))

    def _faces(self, faces: Faces, head: Header) -> None:
        self._seen, self._heard_s = faces, time.monotonic()
        at = self._header(head)
        crop = self._crops.of(head.captured_ns)
        for face in faces.faces:
            self._write(face.track_id, "roi", humans.roi(face, faces, at))
            self._write(face.track_id, "landmarks", humans.landmarks(face, faces, at))
            if self._route.image:
                self._writer(face.track_id, "cropped")  # to be found before it is read
            if crop is not None:
                cropped = to_record(crop(face.box, at["frame_id"]), humans.PARTS["cropped"], 0)
                self._write(face.track_id, "cropped", {**cropped, "header": at})
        self._tell([face.track_id for face in faces.faces], at)
        for track_id in self._writers.keys() - {face.track_id for face in faces.faces}:
            self._lose(track_id)
        self._count.inc()

    def _expressions(self, expressions: Expressions, head: Header) -> None:
        at = self._header(head)
        for seen in expressions.expressions:
            if seen.track_id in self._writers:
                self._write(seen.track_id, "expression", humans.expression(seen, at))
                if seen.action_units:
                    self._write(seen.track_id, "facs", humans.action_units(seen, at))

    def _poses(self, poses: HeadPoses, head: Header) -> None:
        at = self._header(head)
        faces: dict[int, Face] = {face.track_id: face for face in self._seen.faces}
        for pose in poses.head_poses:
            if pose.track_id in faces and self._transforms is not None and self._frame_id():
                record = humans.transforms(
                    faces[pose.track_id], pose, self._seen, self._route.field_of_view_deg, at
                )
                self._transforms.write(self._kit.cdr.encode(record, humans.TRANSFORMS_TYPE))

    def _image(self, image: Image, head: Header) -> None:
        self._crops.keep(image, head.captured_ns)

    def _header(self, head: Header) -> Record:
        return header(self._frame_id(), head.captured_ns)

    def _frame_id(self) -> str:
        return self._seen.frame_id or self._route.frame_id

    def _tell(self, track_ids: list[int], at: Record) -> None:
        record = humans.tracked(track_ids, at)
        self._tracked.write(self._kit.cdr.encode(record, humans.TRACKED_TYPE))

    def _write(self, track_id: int, part: str, record: Record) -> None:
        payload = self._kit.cdr.encode(record, humans.PARTS[part])
        self._writer(track_id, part).write(payload)

    def _writer(self, track_id: int, part: str) -> Writer:
        writers = self._writers.setdefault(track_id, {})
        if part not in writers:
            name = humans.topic(track_id, part)
            writers[part] = self._kit.transport.writer(name, humans.PARTS[part], _QOS)
        return writers[part]

    def _lose(self, track_id: int) -> None:
        for writer in self._writers.pop(track_id).values():
            writer.close()

    def _lose_all(self) -> None:
        """Tell that nobody is seen any more."""
        if self._writers:
            self._tell([], self._header(Header(captured_ns=time.time_ns())))
        for track_id in list(self._writers):
            self._lose(track_id)

    async def close(self) -> None:
        """End it."""
        work = list(self._work.values())
        for task in work:
            task.cancel()
        if work:
            await asyncio.wait(work)
        self._lose_all()
        for writer in (self._tracked, self._transforms):
            if writer is not None:
                writer.close()
        self._report("")
