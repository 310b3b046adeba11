from __future__ import annotations

import asyncio
from collections.abc import Sequence

from vertebra_yarp.velocity import PERIOD_S, Runner


async def test_a_joint_that_is_being_stopped_is_not_told_to_run() -> None:
    turn = asyncio.Lock()
    heard: list[tuple[str, *tuple[int, ...]]] = []

    async def say(joints: Sequence[int], _: Sequence[float]) -> None:
        heard.append(("run", *joints))

    async def stop(joints: Sequence[int]) -> None:
        heard.append(("stop", *joints))
        await asyncio.sleep(3 * PERIOD_S)  # the robot takes its time to answer

    runner = Runner("/head", turn, say, stop)
    async with turn:
        await runner.run([2], [20.0], for_s=5)
    await asyncio.sleep(2 * PERIOD_S)
    async with turn:
        await runner.run([1], [5.0], for_s=5)
    runner.forget()

    stopped = heard.index(("stop", 2))
    assert ("run", 2) in heard[:stopped]
    assert heard[stopped + 1 :] == [("run", 1)]
