"""What waits for one viewer: newest wins or refused when full, paced, windowed, counted."""

from __future__ import annotations

import asyncio

import pytest
from hypothesis import given
from hypothesis import strategies as st

from vertebra.bus import Delivery
from vertebra_gateway import streams
from vertebra_gateway.streams import Item, Outlet


def item(number: int, key: str = "a") -> Item:
    return Item(key, "text/plain", b"%d" % number, sent_ns=1, arrived_s=0.0)


def take_all(outlet: Outlet) -> list[bytes]:
    return [taken.payload for taken in iter(outlet.take, None)]


async def test_latest_keeps_the_newest_of_each_key_and_counts_the_rest() -> None:
    outlet = Outlet(lambda: None)
    for number in range(5):
        outlet.offer(item(number, "a"))
    outlet.offer(item(9, "b"))
    assert (outlet.waiting, outlet.dropped) == (2, 4)
    assert take_all(outlet) == [b"4", b"9"]
    assert (outlet.waiting, outlet.dropped) == (0, 4)


async def test_latest_with_depth_keeps_order_and_serves_keys_in_turn() -> None:
    outlet = Outlet(lambda: None, delivery=Delivery.latest(2))
    for number in range(4):
        outlet.offer(item(number, "a"))
        outlet.offer(item(10 + number, "b"))
    assert take_all(outlet) == [b"2", b"12", b"3", b"13"]
    assert outlet.dropped == 4


async def test_queue_refuses_the_new_when_full() -> None:
    outlet = Outlet(lambda: None, delivery=Delivery.queue(3))
    for number in range(5):
        outlet.offer(item(number))
    assert (take_all(outlet), outlet.dropped) == ([b"0", b"1", b"2"], 2)


@pytest.mark.parametrize("delivery", [Delivery.queue(100), Delivery.latest(100)])
async def test_bytes_that_wait_are_bounded(
    delivery: Delivery, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(streams, "MAX_WAITING_BYTES", 10)
    outlet = Outlet(lambda: None, delivery=delivery)
    large = Item("a", "", bytes(20), sent_ns=1, arrived_s=0.0)
    outlet.offer(large)
    assert outlet.take() is large
    for number in range(10, 30):
        outlet.offer(item(number))
    assert (outlet.waiting, outlet.dropped) == (5, 15)


async def test_keys_are_bounded(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(streams, "MAX_KEYS", 3)
    outlet = Outlet(lambda: None)
    for number in range(5):
        outlet.offer(item(number, f"k{number}"))
    assert (outlet.waiting, outlet.dropped) == (3, 2)


async def test_window_gives_no_more_than_was_acknowledged() -> None:
    woken: list[int] = []
    outlet = Outlet(lambda: woken.append(1), window=1)
    outlet.offer(item(1))
    assert take_all(outlet) == [b"1"]
    outlet.offer(item(2))
    outlet.offer(item(3))
    assert outlet.take() is None
    woken.clear()
    outlet.acknowledge()
    assert woken
    assert take_all(outlet) == [b"3"]
    assert outlet.dropped == 1
    outlet.acknowledge()
    outlet.acknowledge()  # one too many opens no larger window
    outlet.offer(item(4))
    assert take_all(outlet) == [b"4"]
    outlet.offer(item(5))
    assert outlet.take() is None


async def test_rate_limit_gives_the_newest_when_it_is_due_and_counts_no_drop() -> None:
    woken = asyncio.Event()
    outlet = Outlet(woken.set, max_rate_hz=20)
    loop = asyncio.get_running_loop()
    outlet.offer(item(1))
    assert take_all(outlet) == [b"1"]
    started_s = loop.time()
    woken.clear()
    for number in range(2, 6):
        outlet.offer(item(number))
    assert outlet.take() is None
    async with asyncio.timeout(5):
        await woken.wait()
    assert loop.time() - started_s >= 0.045
    assert (take_all(outlet), outlet.dropped) == ([b"5"], 0)


async def test_a_viewer_is_told_once_why_it_gets_nothing() -> None:
    reasons: list[str] = []
    outlet = Outlet(lambda: None, on_refusal=reasons.append)
    outlet.refuse("no image")
    outlet.refuse("no image")
    assert reasons == ["no image"]
    outlet.offer(item(1))
    outlet.refuse("no image")
    assert reasons == ["no image", "no image"]


OPERATIONS = st.lists(st.sampled_from(["a", "b", "c", "take", "ack"]), max_size=60)
DELIVERIES = st.builds(Delivery, st.sampled_from(["latest", "queue"]), st.integers(1, 4))


@given(OPERATIONS, DELIVERIES, st.integers(0, 3))
def test_nothing_is_lost_without_being_counted(
    operations: list[str], delivery: Delivery, window: int
) -> None:
    async def play() -> None:
        outlet = Outlet(lambda: None, delivery=delivery, window=window)
        offered = taken = in_flight = 0
        newest: dict[str, int] = {}
        for operation in operations:
            if operation == "ack":
                outlet.acknowledge()
                in_flight = max(0, in_flight - 1)
            elif operation == "take":
                found = outlet.take()
                if found is not None:
                    taken += 1
                    in_flight += 1
                    if delivery == Delivery.latest(1):
                        assert int(found.payload) == newest[found.key]
            else:
                newest[operation] = offered
                outlet.offer(item(offered, operation))
                offered += 1
            assert offered == taken + outlet.waiting + outlet.dropped
            assert outlet.waiting <= delivery.depth * (3 if delivery.policy == "latest" else 1)
            assert not window or in_flight <= window

    asyncio.run(play())
