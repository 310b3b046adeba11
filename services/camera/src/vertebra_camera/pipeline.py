"""What can be decided about images without a camera: sources, sizes, rates. No I/O, no clock."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Final, TypeAlias
from urllib.parse import quote, urlsplit, urlunsplit

from vertebra.keys import check_key

_STREAM_SCHEMES: Final = ("rtsp", "rtsps", "rtmp", "http", "https", "udp", "srt")


@dataclass(frozen=True, slots=True)
class Device:
    """A camera of this machine, such as `/dev/video0`."""

    path: str


@dataclass(frozen=True, slots=True)
class Stream:
    """A camera in the network."""

    url: str

    def with_credentials(self, credentials: str) -> str:
        """Return the URL with `user:password` in it."""
        parts = urlsplit(self.url)
        user, _, password = credentials.partition(":")
        place = f"{quote(user, safe='')}:{quote(password, safe='')}@{parts.netloc}"
        return urlunsplit(parts._replace(netloc=place))


@dataclass(frozen=True, slots=True)
class Files:
    """A picture, a video, or a folder of pictures."""

    path: Path


@dataclass(frozen=True, slots=True)
class Relay:
    """Images on another key."""

    key: str


Source: TypeAlias = Device | Stream | Files | Relay


def parse_source(text: str) -> Source:
    """Return the source that a setting names.

    Raises:
        ValueError: It names none, or holds a password, which belongs into a file.
    """
    if not text:
        raise ValueError("a source is a device, a URL, a path or key:<key>")
    if text.startswith("key:"):
        return Relay(check_key(text.removeprefix("key:")))
    if text.startswith("/dev/"):
        return Device(text)
    scheme, separator, _ = text.partition("://")
    if not separator:
        return Files(Path(text))
    if scheme not in _STREAM_SCHEMES:
        raise ValueError(f"{scheme}:// is not known; use one of {', '.join(_STREAM_SCHEMES)}")
    parts = urlsplit(text)
    if parts.username or parts.password:
        raise ValueError(
            "a password in a URL shows in logs and status: put `user:password` into a file and "
            "name it in credentials_file"
        )
    if not parts.hostname:
        raise ValueError("the URL names no host")
    return Stream(text)


def target_size(width: int, height: int, wanted: tuple[int, int]) -> tuple[int, int]:
    """Return the size of an image that was `width` x `height`.

    Args:
        width: Its pixels in a row.
        height: Its rows.
        wanted: The same as they should be; 0 keeps the aspect, twice 0 the size.
    """
    wanted_width, wanted_height = wanted
    if not wanted_width and not wanted_height:
        return width, height
    return (
        wanted_width or max(1, round(width * wanted_height / height)),
        wanted_height or max(1, round(height * wanted_width / width)),
    )


_JITTER_S: Final = 0.01


class Pace:
    """Lets pass as many images per second as allowed, as evenly as they come.

    An image that is a little early passes, because sources jitter; on average the rate holds.
    """

    def __init__(self, max_rate_hz: float) -> None:
        self._interval_s = 1 / max_rate_hz
        self._early_s = min(_JITTER_S, 0.4 * self._interval_s)
        self._due_s = float("-inf")

    def allows(self, now_s: float) -> bool:
        """Say whether the image that is there at `now_s` may pass."""
        if now_s < self._due_s - self._early_s:
            return False
        follows = now_s < self._due_s + self._interval_s
        self._due_s = (self._due_s if follows else now_s) + self._interval_s
        return True
