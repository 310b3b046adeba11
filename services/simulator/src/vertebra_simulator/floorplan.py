"""Where the base can drive, how it gets from one place to another, and what its laser sees.

The floor is a room with round pillars, seen from above: x to the front of where the robot starts,
y to its left, in metres.
"""

from __future__ import annotations

import heapq
import math
from collections.abc import Iterator
from dataclasses import dataclass
from typing import Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

BEAMS: Final = 360
LASER_MIN_M: Final = 0.05
LASER_MAX_M: Final = 12.0
_CORNERS: Final = 16
"""A way around a pillar bends so many times in a whole turn."""
_HAIR_M: Final = 1e-6


class Point(NamedTuple):
    """A place on the floor."""

    x: float
    y: float


@dataclass(frozen=True, slots=True)
class Pillar:
    """Something round to drive around."""

    middle: Point
    radius_m: float


@dataclass(frozen=True, slots=True)
class FloorPlan:
    """A room with pillars.

    Attributes:
        corner: Its corner with the smallest coordinates.
        opposite: Its corner with the largest.
        pillars: What stands in it.
    """

    corner: Point
    opposite: Point
    pillars: tuple[Pillar, ...] = ()

    def obstacle(self, place: Point, radius_m: float) -> str:
        """Return what something round at `place` would touch; empty if nothing."""
        inside = all(
            low + radius_m <= value <= high - radius_m
            for low, value, high in zip(self.corner, place, self.opposite, strict=True)
        )
        if not inside:  # so is what is no number
            return "a wall"
        for pillar in self.pillars:
            if math.dist(pillar.middle, place) < pillar.radius_m + radius_m:
                return "a pillar"
        return ""

    def way(self, start: Point, goal: Point, radius_m: float) -> list[Point]:
        """Return the shortest way for something round, both ends included; empty if there is none.

        It bends beside pillars only: the room has no corner that one could drive around.
        """
        places = [start, goal, *self._bends(radius_m)]
        best = {0: 0.0}
        before: dict[int, int] = {}
        waiting = [(math.dist(start, goal), 0)]
        while waiting:
            _, here = heapq.heappop(waiting)
            if here == 1:
                break
            for there, place in enumerate(places):
                length = best[here] + math.dist(places[here], place)
                shorter = length < best.get(there, math.inf)
                if shorter and self._sees(places[here], place, radius_m):
                    best[there], before[there] = length, here
                    heapq.heappush(waiting, (length + math.dist(place, goal), there))
        if 1 not in best:
            return []
        steps = [1]
        while steps[-1]:
            steps.append(before[steps[-1]])
        return [places[step] for step in reversed(steps)]

    def _bends(self, radius_m: float) -> Iterator[Point]:
        for pillar in self.pillars:
            around_m = (pillar.radius_m + radius_m) / math.cos(math.pi / _CORNERS) + _HAIR_M
            for number in range(_CORNERS):
                angle = 2 * math.pi * number / _CORNERS
                bend = Point(
                    pillar.middle.x + around_m * math.cos(angle),
                    pillar.middle.y + around_m * math.sin(angle),
                )
                if not self.obstacle(bend, radius_m):
                    yield bend

    def _sees(self, start: Point, end: Point, radius_m: float) -> bool:
        """Say whether the straight way between two places is free.

        An end that is already nearer to a pillar may not come nearer, but may leave it.
        """
        for pillar in self.pillars:
            ends_m = min(math.dist(pillar.middle, start), math.dist(pillar.middle, end))
            free_m = min(pillar.radius_m + radius_m, ends_m) - _HAIR_M
            if _distance(pillar.middle, start, end) < free_m:
                return False
        return True

    def scan(self, place: Point, heading: float) -> NDArray[np.float32]:
        """Return how far a laser at `place` sees: `BEAMS` metres, from the back over the right.

        What is beyond `LASER_MAX_M` is infinitely far, as ROS says it.
        """
        angles = heading - math.pi + np.arange(BEAMS) * (2 * math.pi / BEAMS)
        beams = np.stack((np.cos(angles), np.sin(angles)))
        here = np.array(place)
        low, high = np.array(self.corner) - here, np.array(self.opposite) - here
        with np.errstate(divide="ignore"):  # a beam that runs along a wall does not meet it
            to_walls = np.where(beams > 0, high[:, None], -low[:, None]) / np.abs(beams)
        ranges: NDArray[np.float64] = to_walls.min(axis=0)
        for pillar in self.pillars:
            ranges = np.minimum(ranges, _to_circle(np.array(pillar.middle) - here, beams, pillar))
        ranges[ranges > LASER_MAX_M] = np.inf
        return ranges.astype(np.float32)


ROOM: Final = FloorPlan(Point(-2.0, -2.5), Point(4.0, 2.5), (Pillar(Point(1.5, 0.3), 0.2),))


def _distance(point: Point, start: Point, end: Point) -> float:
    """Return how near a straight way comes to a point."""
    dx, dy = end.x - start.x, end.y - start.y
    length2 = dx * dx + dy * dy
    along = 0.0
    if length2:
        along = ((point.x - start.x) * dx + (point.y - start.y) * dy) / length2
    along = min(max(along, 0.0), 1.0)
    return math.hypot(start.x + along * dx - point.x, start.y + along * dy - point.y)


def _to_circle(
    middle: NDArray[np.float64], beams: NDArray[np.float64], pillar: Pillar
) -> NDArray[np.float64]:
    """Return how far each beam goes until it meets a pillar; infinite if it does not."""
    along = middle @ beams
    beside2 = middle @ middle - along**2
    inside2 = pillar.radius_m**2 - beside2
    hits = (inside2 >= 0) & (along > 0)
    ranges = np.full(beams.shape[1], np.inf)
    ranges[hits] = along[hits] - np.sqrt(inside2[hits])
    return ranges
