"""What a base may be asked, and that it stops by itself."""

from __future__ import annotations

import asyncio
import json
from typing import Any

import pytest

from vertebra.errors import CommandRefusedError, TransportError
from vertebra.testing.bus_suite import eventually
from vertebra_ros2.drive import MAX_FOR_S, PERIOD_S, STILL, Drive, Runner, limits_of, read
from vertebra_ros2.routes import Base

BASE = Base(ros="/cmd_vel", key="robot/base", max_linear_m_s=0.8, max_angular_deg_s=90.0)


def asked(**fields: Any) -> bytes:
    return json.dumps(fields).encode()


def test_what_is_left_out_is_nothing() -> None:
    assert read(b"", BASE) == Drive(linear_m_s=0.0, angular_deg_s=0.0, for_s=0.5)
    assert read(asked(angular_deg_s=-20), BASE) == Drive(angular_deg_s=-20.0)


@pytest.mark.parametrize("linear", [0.8, -0.8])
def test_the_limits_themselves_may_be_asked(linear: float) -> None:
    drive = read(asked(linear_m_s=linear, angular_deg_s=90, for_s=MAX_FOR_S), BASE)
    assert drive.linear_m_s == linear


@pytest.mark.parametrize(
    ("payload", "complaint"),
    [
        (asked(linear_m_s=0.81), r"linear_m_s = 0.81 m/s is outside its limits, -0.8 to 0.8 m/s"),
        (asked(angular_deg_s=-91), "angular_deg_s = -91 deg/s is outside its limits, -90 to 90"),
        (asked(for_s=2.1), "for_s = 2.1 s is outside its limits, above 0 to 2 s; send"),
        (asked(for_s=0), "for_s = 0 s is outside"),
        (asked(for_s=-1), "for_s = -1 s is outside"),
        (b'{"linear_m_s": 1e999}', "linear_m_s"),
        (b'{"linear_m_s": NaN}', "takes a JSON object of linear_m_s, angular_deg_s, for_s"),
        (asked(linear_m_s="fast"), "takes a JSON object"),
        (asked(linear_m_s=True), "takes a JSON object"),
        (asked(speed=1), "takes a JSON object of .* unknown field `speed`"),
        (b"[0.3, 0]", "takes a JSON object"),
        (b"{", "takes a JSON object"),
    ],
)
def test_what_the_base_must_not_do_is_refused(payload: bytes, complaint: str) -> None:
    with pytest.raises(CommandRefusedError, match=complaint):
        read(payload, BASE)


def test_limits_have_the_form_of_those_of_joints() -> None:
    assert limits_of(BASE) == {
        "joints": [
            {
                "name": "base",
                "min_linear_m_s": -0.8,
                "max_linear_m_s": 0.8,
                "min_angular_deg_s": -90.0,
                "max_angular_deg_s": 90.0,
            }
        ]
    }


class Wheels:
    """Notes what it is told, and when."""

    def __init__(self) -> None:
        self.told: list[tuple[float, Drive]] = []
        self.runner = Runner("robot/base", self.say)
        self.lost = False

    def say(self, drive: Drive) -> None:
        if self.lost:
            raise TransportError("gone")
        self.told.append((asyncio.get_running_loop().time(), drive))

    @property
    def drives(self) -> list[Drive]:
        return [drive for _, drive in self.told]

    async def silent(self) -> float:
        """Wait until it is told nothing more; return how long it was told something."""
        while asyncio.get_running_loop().time() < self.told[-1][0] + 4 * PERIOD_S:
            await asyncio.sleep(PERIOD_S)
        return self.told[-1][0] - self.told[0][0]


FORTH = Drive(linear_m_s=0.3, for_s=0.3)


async def test_it_is_told_again_and_again_until_its_time_is_up() -> None:
    base = Wheels()
    base.runner.run(FORTH)
    assert base.drives == [FORTH]
    driven_s = await base.silent()
    assert base.drives == [FORTH] * (len(base.told) - 1) + [STILL]
    assert 5 <= len(base.told) <= 8
    assert driven_s == pytest.approx(FORTH.for_s, abs=0.1)


async def test_a_later_command_takes_the_place_of_the_earlier() -> None:
    base = Wheels()
    back = Drive(linear_m_s=-0.1, for_s=0.15)
    base.runner.run(Drive(linear_m_s=0.3, for_s=2.0))
    await asyncio.sleep(0.12)
    base.runner.run(back)
    driven_s = await base.silent()
    first_back = base.drives.index(back)
    assert set(base.drives[first_back:-1]) == {back}
    assert base.drives[-1] == STILL
    assert driven_s < 0.5


async def test_it_is_driven_for_longer_by_saying_so_again() -> None:
    base = Wheels()
    for _ in range(4):
        base.runner.run(FORTH)
        await asyncio.sleep(0.2)
    assert STILL not in base.drives
    assert await base.silent() > 0.8
    assert base.drives.count(STILL) == 1


async def test_halt_says_so_at_once_and_nothing_after_it() -> None:
    base = Wheels()
    assert not base.runner.halt()
    assert base.told == []
    base.runner.run(FORTH)
    assert base.runner.halt()
    assert base.drives == [FORTH, STILL]
    await asyncio.sleep(4 * PERIOD_S)
    assert base.drives == [FORTH, STILL]
    assert not base.runner.halt()


async def test_a_base_that_is_lost_is_told_of(caplog: pytest.LogCaptureFixture) -> None:
    base = Wheels()
    base.runner.run(FORTH)
    base.lost = True
    await eventually(lambda: "robot/base was lost while it was driven: gone" in caplog.text)
    base.lost = False
    base.runner.run(FORTH)
    await base.silent()
    assert base.drives[-1] == STILL
