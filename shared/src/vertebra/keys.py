"""Keys and key expressions of the backbone, and the way foreign names become keys.

A *key* is a concrete Zenoh address (`vizzy/head/state`), a *key expression* a pattern over keys
(`vizzy/**`). Zenoh refuses a leading or trailing `/`, an empty chunk, `#`, `?`, and `$` outside
`$*`; it accepts blanks (we do not) and hides every chunk that starts with `@` from `*` and `**`.

Foreign names are mapped injectively: `unmap_name(prefix, map_name(prefix, name)) == name`.
"""

from __future__ import annotations

from functools import lru_cache
from typing import Final

from vertebra.errors import NameMappingError

CONTROL_PREFIX: Final = "@vertebra"
"""Presence, status and control of the fleet live under this chunk, invisible to `*` and `**`."""

_ESCAPED: Final = frozenset("%*$#? /") | {chr(code) for code in range(0x20)} | {"\x7f"}
_EMPTY_CHUNK: Final = "%"  # never the start of an escape: those have two hexadecimal digits
_UNROOTED: Final = "%."


def check_key(key: str) -> str:
    """Return `key` if it is a concrete key, else raise `NameMappingError` pointing at the fault."""
    _check(key, wildcards=False)
    return key


def check_key_expression(expression: str) -> str:
    """Return `expression` if Zenoh and we accept it, else raise `NameMappingError`."""
    _check(expression, wildcards=True)
    return expression


def _check(text: str, *, wildcards: bool) -> None:
    kind = "key expression" if wildcards else "key"
    if not text:
        raise NameMappingError(text, 0, f"a {kind} is not empty")
    position = 0
    previous = ""
    for chunk in text.split("/"):
        if not chunk:
            raise NameMappingError(text, position, f"a {kind} has no empty chunk")
        bare = chunk
        if wildcards:
            if chunk in ("*", "**"):
                if previous == "**":
                    raise NameMappingError(
                        text, position, f"write '*/**' instead of '**/{chunk}' in a {kind}"
                    )
                bare = ""
            elif chunk == "$*" or "$*$*" in chunk:
                shorter = "'*' instead of '$*'" if chunk == "$*" else "'$*' once"
                raise NameMappingError(text, position, f"write {shorter} in a {kind}")
            else:
                bare = chunk.replace("$*", "__")
        for offset, character in enumerate(bare):
            if character in "#?$*" or character.isspace() or not character.isprintable():
                raise NameMappingError(
                    text, position + offset, f"{character!r} is not allowed in a {kind}"
                )
        previous = chunk
        position += len(chunk) + 1


def map_name(prefix: str, name: str) -> str:
    """Return the key below `prefix` that stands for the foreign `name`.

    Chunks are kept readable; only what Zenoh or this mapping gives a meaning is percent-encoded.
    """
    rooted = name.startswith("/")
    chunks = [_escape(chunk) for chunk in name.removeprefix("/").split("/")]
    return "/".join([prefix, *([] if rooted else [_UNROOTED]), *chunks])


def unmap_name(prefix: str, key: str) -> str:
    """Return the foreign name behind `key`; raise `NameMappingError` if no name maps to it."""
    head = f"{prefix}/"
    if not key.startswith(head):
        raise NameMappingError(key, 0, f"a key below {prefix!r} was expected")
    chunks = key[len(head) :].split("/")
    rooted = chunks[0] != _UNROOTED
    if not rooted:
        chunks = chunks[1:]
    name = ("/" if rooted else "") + "/".join(_unescape(key, chunk) for chunk in chunks)
    if map_name(prefix, name) != key:
        raise NameMappingError(key, len(head), "this key is not the canonical form of any name")
    return name


def _escape(chunk: str) -> str:
    if not chunk:
        return _EMPTY_CHUNK
    text = "".join(
        "".join(f"%{byte:02X}" for byte in character.encode("utf-8", "surrogatepass"))
        if character in _ESCAPED or not character.isprintable()
        else character
        for character in chunk
    )
    return f"%40{text[1:]}" if text.startswith("@") else text


def _unescape(key: str, chunk: str) -> str:
    if chunk == _EMPTY_CHUNK:
        return ""
    raw = bytearray()
    index = 0
    while index < len(chunk):
        if chunk[index] == "%":
            digits = chunk[index + 1 : index + 3]
            if len(digits) != 2 or not all(digit in "0123456789ABCDEF" for digit in digits):
                raise NameMappingError(key, key.find(chunk) + index, "'%' starts no escape here")
            raw.append(int(digits, 16))
            index += 3
        else:
            raw += chunk[index].encode("utf-8", "surrogatepass")
            index += 1
    try:
        return raw.decode("utf-8", "surrogatepass")
    except UnicodeDecodeError as error:
        raise NameMappingError(key, key.find(chunk), "the escapes are not UTF-8") from error


@lru_cache(maxsize=4096)
def intersects(left: str, right: str) -> bool:
    """Say whether any key matches both key expressions (a key is an expression of itself)."""
    return _intersect(tuple(left.split("/")), tuple(right.split("/")))


def _intersect(left: tuple[str, ...], right: tuple[str, ...]) -> bool:
    if not left or not right:
        return all(chunk == "**" for chunk in left or right)
    if left[0] == "**":
        return _intersect(left[1:], right) or (
            (right[0] == "**" or not right[0].startswith("@")) and _intersect(left, right[1:])
        )
    if right[0] == "**":
        return _intersect(right, left)
    return _chunks_intersect(left[0], right[0]) and _intersect(left[1:], right[1:])


def _chunks_intersect(left: str, right: str) -> bool:
    if left == right:
        return True
    if left.startswith("@") or right.startswith("@"):
        return False
    if left == "*" or right == "*":
        return True
    return _globs_intersect(left.replace("$*", "*"), right.replace("$*", "*"))


def _globs_intersect(left: str, right: str) -> bool:
    if not left or not right:
        return all(character == "*" for character in left or right)
    if left[0] == "*":
        return _globs_intersect(left[1:], right) or _globs_intersect(left, right[1:])
    if right[0] == "*":
        return _globs_intersect(right, left)
    return left[0] == right[0] and _globs_intersect(left[1:], right[1:])
