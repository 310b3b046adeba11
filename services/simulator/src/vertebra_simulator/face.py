"""The face: what the words of iCub's `emotionInterface` make of it, and how it looks.

Requests are `set <part> <expression>`, answers `[ok]` or `[fail]`; as there, what the face shows
cannot be asked for. It can be seen instead: the face is a picture of lights behind a mask.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Final

from PIL import Image, ImageDraw

from vertebra.yarp import Value, Vocab

WIDTH: Final = 160
HEIGHT: Final = 120
_LIGHT: Final = (255, 70, 60)
_MASK: Final = (238, 236, 230)
_EYE: Final = (30, 30, 40)


@dataclass(frozen=True, slots=True)
class Expression:
    """How a face looks.

    Attributes:
        brow: How much higher the outer end of an eyebrow is than the inner one, in pixels.
        raised: How far the eyebrows are raised.
        open: How far the eyelids are open, 0 to 1.
        smile: How far the corners of the mouth are up.
        round: Half the height of an open mouth, 0 for a closed one.
    """

    brow: int = 0
    raised: int = 0
    open: float = 0.8
    smile: int = 0
    round: int = 0


# The names are those of iCub's emotions.ini.
EXPRESSIONS: Final = {
    "neu": Expression(),
    "hap": Expression(raised=2, open=1.0, smile=9),
    "sad": Expression(brow=-5, open=0.6, smile=-9),
    "sur": Expression(raised=8, open=1.0, round=8),
    "evi": Expression(brow=7, open=0.9, smile=6),
    "ang": Expression(brow=7, open=0.9, smile=-5),
    "shy": Expression(brow=-3, raised=3, open=0.5, smile=3),
    "cun": Expression(brow=4, raised=4, open=0.6, smile=4),
    "ta1": Expression(round=2),
    "ta2": Expression(round=6),
}
PARTS: Final = ("leb", "reb", "eli", "mou")
"""Left and right eyebrow, eyelids, mouth."""


class Face:
    """Shows an expression in each of its parts."""

    def __init__(self) -> None:
        self.shown = dict.fromkeys(PARTS, "neu")

    def answer(self, request: Sequence[Value]) -> list[Value]:
        """Return the answer to a request, having done what it says."""
        match request:
            case ["set", str() as part, str() as name] if name[:3] in EXPRESSIONS:
                parts = PARTS if part == "all" else (part,)
                if set(parts) <= self.shown.keys():
                    self.shown |= dict.fromkeys(parts, name[:3])
                    return [Vocab("ok")]
        return [Vocab("fail")]

    def render(self) -> bytes:
        """Return the face as it looks now: rgb, `WIDTH` x `HEIGHT`."""
        left, right, lids, mouth = (EXPRESSIONS[self.shown[part]] for part in PARTS)
        image = Image.new("RGB", (WIDTH, HEIGHT), _MASK)
        draw = ImageDraw.Draw(image)
        for middle, outwards, brow in ((50, -1, right), (110, 1, left)):
            height = round(13 * lids.open)
            draw.ellipse((middle - 13, 56 - height, middle + 13, 56 + height), fill=_EYE)
            y = 34 - brow.raised
            ends = (middle - 16 * outwards, y + brow.brow, middle + 16 * outwards, y - brow.brow)
            draw.line(ends, fill=_LIGHT, width=5)
        if mouth.round:
            draw.ellipse((66, 92 - mouth.round, 94, 92 + mouth.round), outline=_LIGHT, width=4)
        else:
            corner = 92 - mouth.smile
            curve = [(58, corner), (69, 92), (80, 92 + mouth.smile // 2), (91, 92), (102, corner)]
            draw.line(curve, fill=_LIGHT, width=5, joint="curve")
        return image.tobytes()
