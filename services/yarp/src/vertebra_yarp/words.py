"""The words of a control board on the wire, in the two generations of YARP; no I/O.

YARP 3 speaks bottles of vocabs: requests are `[get] [llim] 0`, answers
`[is] [llim] -30.0 22.0 [tsta] 7 1234.5 [ok]`, refusals `[fail]`. YARP 4 speaks thrift
(`ControlBoardMsgs` of 4.0.0): requests are `getPosLimitsRPC 0`, answers `([ok]) -30.0 22.0`,
refusals `([err5])`. What streams to `command:i` is a bottle and a vector in both.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Final, Protocol

from vertebra.errors import RemoteError
from vertebra.yarp import Dialect, Value, Vocab, to_text

Request = list[Value]

GET: Final = Vocab("get")
SET: Final = Vocab("set")
OK: Final = Vocab("ok")
_STAMP_VALUES: Final = 3  # [tsta] count time
REFUSED: Final = "RobotRefused"


class Words(Protocol):
    """What to say to a control board, and what its answers mean; joints are numbers."""

    def axes(self) -> Request:
        """Ask for the number of joints."""
        ...

    def name(self, joint: int) -> Request:
        """Ask for the name of a joint."""
        ...

    def position_limits(self, joint: int) -> Request:
        """Ask between which positions a joint moves."""
        ...

    def velocity_limits(self, joint: int) -> Request:
        """Ask between which velocities a joint moves."""
        ...

    def positions(self) -> Request:
        """Ask where all joints are."""
        ...

    def speeds(self) -> Request:
        """Ask how fast the position moves of all joints are."""
        ...

    def modes(self) -> Request | None:
        """Ask how all joints are controlled; None if only `stateExt:o` tells."""
        ...

    def arrived(self, joints: Sequence[int]) -> Request:
        """Ask whether the position moves of some joints have ended."""
        ...

    def move(self, joints: Sequence[int], targets: Sequence[float]) -> Request:
        """Tell joints to move somewhere."""
        ...

    def set_speeds(self, joints: Sequence[int], speeds: Sequence[float]) -> list[Request]:
        """Tell joints how fast their position moves shall be."""
        ...

    def set_modes(self, joints: Sequence[int], modes: Sequence[str]) -> Request:
        """Tell joints how they shall be controlled."""
        ...

    def stop(self, joints: Sequence[int]) -> Request:
        """Tell joints to stop."""
        ...

    def stop_all(self) -> Request:
        """Tell all joints to stop."""
        ...

    def direct_head(self, joints: Sequence[int]) -> Request:
        """Return the head of a streamed position-direct command."""
        ...

    def velocity_head(self, joints: Sequence[int]) -> Request:
        """Return the head of a streamed velocity command."""
        ...

    def answer(self, reply: list[Value], request: Request) -> list[Value]:
        """Return the values of an answer, without the words around them.

        Raises:
            RemoteError: The board refused, or said something that no board says.
        """
        ...


class Vocabs:
    """The words of YARP 3."""

    def axes(self) -> Request:
        """See `Words`."""
        return [GET, Vocab("axes")]

    def name(self, joint: int) -> Request:
        """See `Words`."""
        return [GET, Vocab("name"), joint]

    def position_limits(self, joint: int) -> Request:
        """See `Words`."""
        return [GET, Vocab("llim"), joint]

    def velocity_limits(self, joint: int) -> Request:
        """See `Words`."""
        return [GET, Vocab("vlim"), joint]

    def positions(self) -> Request:
        """See `Words`."""
        return [GET, Vocab("encs")]

    def speeds(self) -> Request:
        """See `Words`."""
        return [GET, Vocab("vels")]

    def modes(self) -> Request | None:
        """See `Words`."""
        return [GET, Vocab("icmd"), Vocab("cmds")]

    def arrived(self, joints: Sequence[int]) -> Request:
        """See `Words`."""
        return [GET, Vocab("dong"), len(joints), [*joints]]

    def move(self, joints: Sequence[int], targets: Sequence[float]) -> Request:
        """See `Words`."""
        return [SET, Vocab("posg"), len(joints), [*joints], [*targets]]

    def set_speeds(self, joints: Sequence[int], speeds: Sequence[float]) -> list[Request]:
        """See `Words`; one by one, because 3.12 takes a group of speeds only in part."""
        return [
            [SET, Vocab("vel"), joint, speed] for joint, speed in zip(joints, speeds, strict=True)
        ]

    def set_modes(self, joints: Sequence[int], modes: Sequence[str]) -> Request:
        """See `Words`."""
        words: list[Value] = [*map(Vocab, modes)]
        return [SET, Vocab("icmd"), Vocab("cmog"), len(joints), [*joints], words]

    def stop(self, joints: Sequence[int]) -> Request:
        """See `Words`."""
        return [SET, Vocab("stog"), len(joints), [*joints]]

    def stop_all(self) -> Request:
        """See `Words`."""
        return [SET, Vocab("stos")]

    def direct_head(self, joints: Sequence[int]) -> Request:
        """See `Words`."""
        return [Vocab("dpog"), len(joints), [*joints]]

    def velocity_head(self, joints: Sequence[int]) -> Request:
        """See `Words`."""
        return [Vocab("vmog"), len(joints), [*joints]]

    def answer(self, reply: list[Value], request: Request) -> list[Value]:
        """See `Words`."""
        if not reply or str(reply[-1]) != OK:
            raise refusal(reply, request)
        body = reply[:-1]
        if len(body) >= _STAMP_VALUES and str(body[-_STAMP_VALUES]) == "tsta":
            body = body[:-_STAMP_VALUES]
        if body and str(body[0]) == "is":
            body = body[2:]
        if len(body) == 1 and isinstance(body[0], list):
            return body[0]
        return body


class Thrift:
    """The words of YARP 4.0; nothing there tells control modes but `stateExt:o`."""

    def axes(self) -> Request:
        """See `Words`."""
        return ["getAxesRPC"]

    def name(self, joint: int) -> Request:
        """See `Words`."""
        return ["getAxisNameRPC", joint]

    def position_limits(self, joint: int) -> Request:
        """See `Words`."""
        return ["getPosLimitsRPC", joint]

    def velocity_limits(self, joint: int) -> Request:
        """See `Words`."""
        return ["getVelLimitsRPC", joint]

    def positions(self) -> Request:
        """See `Words`."""
        return ["getEncoderAllRPC"]

    def speeds(self) -> Request:
        """See `Words`."""
        return ["getTrajSpeedsAllRPC"]

    def modes(self) -> Request | None:
        """See `Words`."""
        return None

    def arrived(self, joints: Sequence[int]) -> Request:
        """See `Words`."""
        return ["checkMotionDoneGroupRPC", [*joints]]

    def move(self, joints: Sequence[int], targets: Sequence[float]) -> Request:
        """See `Words`."""
        return ["positionMoveGroupRPC", [*joints], [*targets]]

    def set_speeds(self, joints: Sequence[int], speeds: Sequence[float]) -> list[Request]:
        """See `Words`."""
        return [["setTrajSpeedGroupRPC", [*joints], [*speeds]]]

    def set_modes(self, joints: Sequence[int], modes: Sequence[str]) -> Request:
        """See `Words`; an enumeration travels as the int32 of its vocab."""
        return ["setControlModeGroupRPC", [*joints], [Vocab(mode).code for mode in modes]]

    def stop(self, joints: Sequence[int]) -> Request:
        """See `Words`."""
        return ["stopGroupRPC", [*joints]]

    def stop_all(self) -> Request:
        """See `Words`."""
        return ["stopAllRPC"]

    def direct_head(self, joints: Sequence[int]) -> Request:
        """See `Words`; the interface comes first, unlike in YARP 3."""
        return [Vocab("ipod"), Vocab("dpog"), len(joints), [*joints]]

    def velocity_head(self, joints: Sequence[int]) -> Request:
        """See `Words`; the interface comes first, unlike in YARP 3."""
        return [Vocab("ivel"), Vocab("vmog"), len(joints), [*joints]]

    def answer(self, reply: list[Value], request: Request) -> list[Value]:
        """See `Words`; a command alone is answered by the return value without a list."""
        if reply == [OK]:
            return []
        if not reply or reply[0] != [OK]:
            raise refusal(reply, request)
        body = reply[1:]
        if len(body) == 1 and isinstance(body[0], list):
            return body[0]
        return body


def words_of(dialect: Dialect) -> Words:
    """Return what a control board of this YARP understands."""
    return Vocabs() if dialect is Dialect.V3 else Thrift()


def refusal(reply: Sequence[Value], request: Request) -> RemoteError:
    """Return the error that a robot refused."""
    said = to_text([*reply]) or "nothing"
    return RemoteError(REFUSED, f"the robot answered {said} to {to_text(request)}")


def numbers_of(values: Sequence[Value], count: int) -> list[float]:
    """Return `count` numbers of an answer; raise `RemoteError` for anything else."""
    if len(values) != count:
        raise RemoteError(REFUSED, f"the robot gave {len(values)} values where {count} belong")
    return [*map(number, values)]


def number(value: Value) -> float:
    """Return a number of an answer; raise `RemoteError` for anything else."""
    if value in (OK, "fail"):  # thrift's way to write a bool
        return float(value == OK)
    if isinstance(value, bool | int | float):
        return float(value)
    raise RemoteError(REFUSED, f"the robot gave {value!r} where a number belongs")
