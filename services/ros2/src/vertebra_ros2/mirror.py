"""The mirror: every topic and service of ROS that no route claims, below one key."""

from __future__ import annotations

from collections.abc import Set as AbstractSet

from vertebra.bus import Closeable, Reply, Request
from vertebra.ros2.names import key_of, name_of
from vertebra_ros2.carried import Kit
from vertebra_ros2.parameters import call_mirrored
from vertebra_ros2.routes import Topic
from vertebra_ros2.services import Clients
from vertebra_ros2.topics import InboundTopic
from vertebra_ros2.turns import Turns


class Mirror:
    """What is mirrored now; nothing while another adapter mirrors at the same place."""

    def __init__(self, kit: Kit, clients: Clients, turns: Turns) -> None:
        self._kit = kit
        self._clients = clients
        self._turns = turns
        self._key = kit.context.settings.mirror
        self._topics: dict[str, InboundTopic] = {}
        self._served: Closeable | None = None
        self.work = f"mirror at {self._key}"

    async def look(self, claimed: AbstractSet[str]) -> None:
        """Mirror what the graph shows now, but for the topics that have a route."""
        is_ours = self._turns.is_ours(self.work)
        self._tell_collision()
        self._serve(is_ours=is_ours)
        graph = self._kit.transport.graph
        wanted = {name for name in graph.topics() if is_ours and graph.writers(name)} - claimed
        for name in self._topics.keys() - wanted:
            await self.drop(name)
        for name in wanted - self._topics.keys():
            route = Topic(ros=name, key=key_of(name, self._key))
            self._topics[name] = InboundTopic(self._kit, route)
            self._kit.context.routes[name] = route.key
        for topic in self._topics.values():
            topic.look()

    async def drop(self, name: str) -> None:
        """Mirror a topic no more."""
        topic = self._topics.pop(name, None)
        if topic is not None:
            self._kit.context.routes.pop(name, None)
            await topic.close()

    def _tell_collision(self) -> None:
        """Tell if the place is another domain's: names of two domains are not mixed."""
        first = self._turns.first(self.work)
        problem = ""
        if first is not None and first.domain_id != self._kit.context.settings.domain_id:
            problem = (
                f"nothing, because {self._key!r} is the mirror of domain {first.domain_id}; set "
                "VERTEBRA_ROS2_MIRROR to another key"
            )
        self._kit.report("mirror", problem)

    def _serve(self, *, is_ours: bool) -> None:
        if is_ours and self._served is None:
            self._served = self._kit.context.bus.serve(f"{self._key}/**", self._call)
        elif not is_ours and self._served is not None:
            self._served.close()
            self._served = None

    async def _call(self, request: Request) -> Reply:
        return await call_mirrored(
            self._kit, self._clients, name_of(request.key, self._key), request
        )

    async def close(self) -> None:
        """End it."""
        self._serve(is_ours=False)
        for name in tuple(self._topics):
            await self.drop(name)
