"""Wiring: the action `/navigate_to_pose`, one goal at a time, as Nav2 has it."""

from __future__ import annotations

import logging
import math
import time
from collections.abc import Mapping
from typing import Any, Final

from vertebra.errors import CodecError
from vertebra.goals import Ended
from vertebra.ros2.action_server import ActionServer, ServerGoal
from vertebra.ros2.cdr import Cdr
from vertebra.ros2.driver import Transport
from vertebra_simulator import records
from vertebra_simulator.base import STILL, Base
from vertebra_simulator.floorplan import FloorPlan
from vertebra_simulator.navigator import Navigation

log = logging.getLogger(__name__)

ACTION: Final = "/navigate_to_pose"
TYPE: Final = "nav2_msgs/action/NavigateToPose"
FRAMES: Final = ("", "odom", "map")
"""All the same: the odometry of this base is the truth."""
TELL_EVERY: Final = 4
"""So many looks ahead make one feedback: 5 in a second."""


class Journey(ServerGoal):
    """A goal, and the way there."""

    def __init__(self, goal_id: str, accepted_ns: int, way: Navigation, began_s: float) -> None:
        super().__init__(goal_id, accepted_ns)
        self.way = way
        self.began_s = began_s
        self.looks = 0


class Journeys:
    """Where the base goes by itself.

    Attributes:
        doing: What it does, in words.
    """

    def __init__(self, transport: Transport, cdr: Cdr, base: Base, plan: FloorPlan) -> None:
        self.doing = "idle"
        self._base = base
        self._plan = plan
        self._journey: Journey | None = None
        self._server: ActionServer[Journey] = ActionServer(transport, cdr, ACTION, TYPE, self)

    async def accept(self, goal_id: str, wanted: Mapping[str, Any]) -> Journey | None:
        """Return a journey; None for a frame that is not known, or what is no number."""
        frame_id = wanted["pose"]["header"]["frame_id"]
        pose = records.read_pose(wanted["pose"]["pose"])
        if frame_id not in FRAMES:
            log.warning("refused a goal in the frame %r; known: odom, map", frame_id)
            return None
        if not all(map(math.isfinite, (pose.x_m, pose.y_m, pose.heading_rad))):
            log.warning("refused a goal that is no pose: %s", pose)
            return None
        way = Navigation(self._plan, pose)
        return Journey(goal_id, time.time_ns(), way, self._base.time_s)

    def begin(self, goal: Journey) -> None:
        """Go there, and no more to where an earlier goal was."""
        if self._journey is not None:
            self._end(self._journey, "aborted", "gave up: a later goal has come")
        self._journey = goal
        self.doing = "on the way"

    async def cancel(self, goal: Journey) -> bool:
        """Stop; the goal ends when the base stands."""
        del goal
        return True

    def refuse(self, error: CodecError) -> None:
        """Note a request that could not be read."""
        log.warning("refused on %s: %s", ACTION, error)

    def go_on(self, *, by_hand: bool) -> None:
        """Drive on, unless somebody drives by hand; tell how far it is."""
        journey, base = self._journey, self._base
        if journey is None:
            return
        if journey.state == "canceling":
            if not by_hand:
                base.drive(STILL)
            if by_hand or base.velocity == STILL:
                self._end(journey, "canceled", "cancelled")
            return
        outlook = journey.way.look(base)
        if not by_hand:
            base.drive(outlook.velocity)
        if outlook.failure is not None:
            self._end(journey, "aborted", f"gave up: {outlook.problem}", int(outlook.failure))
        elif outlook.arrived:
            self._end(journey, "succeeded", "arrived")
        else:
            if journey.looks % TELL_EVERY == 0:
                driven_s = base.time_s - journey.began_s
                told = records.progress(base, outlook, driven_s, time.time_ns())
                self._server.tell(journey, told)
            journey.looks += 1

    def _end(self, journey: Journey, state: Ended, doing: str, error_code: int = 0) -> None:
        self.doing = doing
        self._journey = None
        log.info("navigation: %s", doing)
        self._server.end(journey, state, {"error_code": error_code})
