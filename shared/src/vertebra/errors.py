"""The errors that Vertebra raises on purpose, cut by what the caller can do.

    VertebraError
    ├── ConfigError              mend the configuration and start again
    ├── TransportError           the other side is at fault or away: try again later
    │   ├── NotConnectedError    nobody is there (also a ConnectionError)
    │   ├── DeadlineError        no answer in time (also a TimeoutError)
    │   ├── BusyError            refused because a bounded queue is full
    │   └── RemoteError          the other side answered with an error
    ├── CodecError               this message is bad, its stream lives on (also a ValueError)
    │   ├── CodecNotFoundError   nothing installed here reads or writes it (also a LookupError)
    │   ├── DecodeError          these bytes are damaged or foreign
    │   └── EncodeError          this value has no form in the encoding that was asked for
    ├── NameMappingError         this name cannot cross to the other side (also a ValueError)
    └── CommandRefusedError      a command outside its schema or limits (also a ValueError)

Every error builds its own text from the values it was given and names the remedy. An error that
leaves a service uncaught stops the service; one that concerns a single message never does.
"""

from __future__ import annotations


class VertebraError(Exception):
    """Root of every error raised on purpose."""


class ConfigError(VertebraError):
    """Settings, routes or profiles that cannot work; mend them and start again."""


class TransportError(VertebraError):
    """The other side is at fault or away; the same call may succeed later."""


class NotConnectedError(TransportError, ConnectionError):
    """Nobody is there: not connected yet, or the connection was lost."""


class DeadlineError(TransportError, TimeoutError):
    """No answer arrived before the deadline.

    Attributes:
        what: What was waited for.
        timeout_s: The deadline in seconds.
    """

    def __init__(self, what: str, timeout_s: float) -> None:
        super().__init__(f"no answer from {what} within {timeout_s:g} s")
        self.what = what
        self.timeout_s = timeout_s


class BusyError(TransportError):
    """A bounded queue is full and its policy is to refuse rather than to drop.

    Attributes:
        what: Whose queue it is.
        limit: How many entries it holds.
    """

    def __init__(self, what: str, limit: int) -> None:
        super().__init__(f"{what} is busy: {limit} requests are waiting already; try again later")
        self.what = what
        self.limit = limit


class RemoteError(TransportError):
    """The other side answered, and its answer is an error.

    Attributes:
        kind: Name of the error's class over there, for example `CommandRefusedError`.
        detail: Its text.
    """

    def __init__(self, kind: str, detail: str) -> None:
        super().__init__(f"{kind}: {detail}")
        self.kind = kind
        self.detail = detail


class CodecError(VertebraError, ValueError):
    """This message is bad; the stream it came on lives on."""


class CodecNotFoundError(CodecError, LookupError):
    """Nothing installed here reads or writes this encoding or type."""


class DecodeError(CodecError):
    """These bytes are damaged, truncated, oversized or foreign."""


class EncodeError(CodecError):
    """This value has no form in the encoding that was asked for."""


class NameMappingError(VertebraError, ValueError):
    """A name that cannot cross to the other side, with a caret under the reason.

    Attributes:
        name: The name as it was given.
        position: Index of the first bad character.
    """

    def __init__(self, name: str, position: int, reason: str) -> None:
        super().__init__(f"{reason}\n    {name!r}\n    {' ' * (position + 1)}^")
        self.name = name
        self.position = position


class CommandRefusedError(VertebraError, ValueError):
    """A command that its schema or limits forbid; nothing was sent to the robot."""
