"""Bottles as text, which people type and the text carriers send.

Reading follows YARP's own reader to the letter, oddities included: a lone `-` is 0, `1e` is 0.0,
integers are read as C does (`0x1F`, and `010` is 8), and what is left open at the end is lost.
`is_complete` tells beforehand that something is left open.
"""

from __future__ import annotations

import math
import re
from collections.abc import Sequence
from typing import Final

from vertebra.errors import DecodeError, EncodeError
from vertebra.yarp.protocol.bottle import DEFAULT_LIMITS, Int64, Value, Vocab, Vocab64
from vertebra.yarp.protocol.dialect import Dialect

_BARE_STRING: Final = re.compile(r"[A-Za-z_][A-Za-z0-9_.-]*")
_ESCAPES: Final = str.maketrans(
    {"\n": r"\n", "\r": r"\r", "\0": r"\0", "\\": r"\\", '"': r"\""},
)
_ESCAPED: Final = re.compile(r"\\(.?)", re.DOTALL)
_UNESCAPED: Final = {"n": "\n", "r": "\r", "0": "\0"}

_MARK: Final = re.compile(r'\\.|[ \t\n\r,"(){}]', re.DOTALL)
# Zeros and signs first, in any order; an x among them makes the rest hexadecimal. Possessive, so
# that a megabyte of zeros costs one pass.
_NUMBER: Final = re.compile(r"([0+-]*+)(?:([xX][0+xX-]*+)[0-9.eE+\-A-Fa-f]*+|[0-9.eE+-]*+)")
_INTEGER: Final = re.compile(r"([+-]?)(0[xX][0-9a-fA-F]+|0[0-7]*|[1-9][0-9]*)")
_NOT_FINITE: Final = {"inf": math.inf, "-inf": -math.inf, "nan": math.nan}


def to_text(values: Sequence[Value], dialect: Dialect = Dialect.V3) -> str:
    """Return `values` as YARP prints them, numbers with 21 digits.

    Raises:
        EncodeError: A value has no form in this dialect.
    """
    return " ".join([_printed(value, dialect) for value in values])


def from_text(text: str, dialect: Dialect = Dialect.V3) -> list[Value]:
    """Return what YARP reads from `text`; anything is a bottle to it.

    Raises:
        DecodeError: Lists nest too deep.
    """
    return _parsed(text, dialect, 0)


def is_complete(text: str) -> bool:
    """Tell whether `text` closes what it opens; if not, the bottle goes on in the next line."""
    return not text.endswith("\\") and _split(text)[1]


def join_lines(text: str, next_line: str) -> str:
    """Return the incomplete `text` with the line that continues it."""
    if text.endswith("\\"):
        return text[:-1] + next_line
    return f"{text}\n{next_line}"


# --- printing --------------------------------------------------------------------------------


def _printed(value: Value, dialect: Dialect) -> str:
    if isinstance(value, Vocab):
        return _printed_vocab(value, dialect)
    if isinstance(value, str):
        return _printed_string(value)
    if isinstance(value, bool):
        return "true" if value else "false"
    if isinstance(value, int):
        return _printed_int(value)
    if isinstance(value, float):
        return _printed_float(value)
    if isinstance(value, bytes):
        return "{" + " ".join(map(str, value)) + "}"
    if isinstance(value, (list, tuple)):
        return f"({to_text(value, dialect)})"
    raise EncodeError(f"a bottle cannot hold a {type(value).__name__}")


def _printed_vocab(value: Vocab, dialect: Dialect) -> str:
    if dialect.vocab64 is None and (len(value) > 4 or isinstance(value, Vocab64)):
        raise EncodeError(f"{value!r} is a vocab of 8 bytes; YARP 3 has only 4: send a str")
    if value in ("", "1"):
        return "true" if value else "false"
    return "[" + value.replace("\0", "") + "]"


def _printed_string(value: str) -> str:
    if _BARE_STRING.fullmatch(value) and value not in ("true", "false"):
        return value
    return f'"{value.translate(_ESCAPES)}"'


def _printed_int(value: int) -> str:
    if not -(2**63) <= value < 2**63:
        raise EncodeError(f"an integer of {value.bit_length()} bits does not fit a bottle: 64 do")
    return int.__repr__(value)


def _printed_float(value: float) -> str:
    text = f"{float(value):.21g}"
    return text if "." in text or "e" in text or not math.isfinite(value) else f"{text}.0"


# --- parsing ---------------------------------------------------------------------------------


def _split(text: str) -> tuple[list[str], bool]:
    """Cut `text` into its words; also tell whether everything that it opens is closed."""
    words = []
    text += " "
    begin = lists = blobs = 0
    quoted = False
    for match in _MARK.finditer(text):
        mark = match[0]
        if mark == '"':
            quoted = not quoted
        elif quoted or mark[0] == "\\":
            continue
        elif mark == "(":
            lists += 1
        elif mark == ")":
            lists -= 1
        elif mark == "{":
            blobs += 1
        elif mark == "}":
            blobs -= 1
        elif not lists and not blobs:
            if match.start() > begin:
                words.append(text[begin : match.start()])
            begin = match.end()
    return words, not (quoted or lists or blobs)


def _parsed(text: str, dialect: Dialect, depth: int) -> list[Value]:
    if depth > DEFAULT_LIMITS.max_depth:
        raise DecodeError(f"lists nest deeper than {DEFAULT_LIMITS.max_depth} levels")
    return [_parsed_word(word, dialect, depth) for word in _split(text)[0]]


def _parsed_word(word: str, dialect: Dialect, depth: int) -> Value:
    first = word[0]
    if first == "(":
        return _parsed(word[1:-1], dialect, depth + 1)
    if first == "{":
        return bytes(_byte(value) for value in _parsed(word[1:-1], dialect, depth + 1))
    if first == "[":
        return _vocab(word[1:-1], dialect)
    if word == "null":
        return Vocab("null")
    if word in _NOT_FINITE:
        return _NOT_FINITE[word]
    if _is_number(word):
        return _number(word)
    text = _unescaped(word[1:-1] if first == '"' else word)
    if first != '"' and text in ("true", "false"):
        return text == "true"
    return text


def _is_number(word: str) -> bool:
    if word[0] not in "+-.0123456789" or word == "." or word.count(".") > 1:
        return False
    match = _NUMBER.fullmatch(word)
    if match is None:
        return False
    preamble = word[: match.end(2)] if match[2] else match[1]
    hex_digits = len(word) - 1 - max(preamble.rfind("x"), preamble.rfind("X")) if match[2] else 0
    return preamble.count("+") + preamble.count("-") <= 1 and hex_digits <= 8


def _number(word: str) -> int | float:
    is_hex = "x" in word or "X" in word
    if "." in word or (not is_hex and ("e" in word or "E" in word)):
        return _float(word, is_hex=is_hex)
    match = _INTEGER.match(word)
    if match is None:
        return 0
    sign, digits = match.groups()
    base = 16 if digits[1:2] in ("x", "X") else 8 if digits[0] == "0" else 10
    significant = digits.lstrip("0xX") or "0"
    # C saturates; and Python refuses to read thousands of digits.
    magnitude = int(significant, base) if len(significant) < 30 else 2**63
    value = max(-magnitude, -(2**63)) if sign == "-" else min(magnitude, 2**63 - 1)
    return value if -(2**31) <= value < 2**31 else Int64(value)


def _float(word: str, *, is_hex: bool) -> float:
    try:
        return float.fromhex(word) if is_hex else float(word)
    except (ValueError, OverflowError):
        return 0.0


def _unescaped(text: str) -> str:
    return _ESCAPED.sub(lambda match: _UNESCAPED.get(match[1], match[1]), text)


def _vocab(text: str, dialect: Dialect) -> bool | Vocab:
    try:
        raw = text.encode("utf-8", "surrogateescape")
    except UnicodeEncodeError as error:
        raise DecodeError(f"the vocab {text[:80]!r} is no text: {error}") from None
    if dialect.vocab64 is not None and len(raw) > 4:
        return Vocab64(raw[:8].decode("utf-8", "surrogateescape"))
    word = raw[:4].decode("utf-8", "surrogateescape")
    return word == "1" if word in ("", "1") else Vocab(word)


def _byte(value: Value) -> int:
    """Return the value as an element of a blob; YARP takes what is no number as 0."""
    if isinstance(value, bool):
        return ord("1") if value else 0
    if isinstance(value, Vocab):
        return value.code & 0xFF
    if isinstance(value, int):
        return value & 0xFF
    if isinstance(value, float) and math.isfinite(value):
        return int(value) & 0xFF
    return 0
