"""What the camera answers on its YARP rpc: that of `frameGrabber_nws_yarp`, width and height."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Final

from vertebra.yarp import Value, Vocab
from vertebra_simulator.scene import Camera

_VISUAL: Final = Vocab("visr")


def answer(request: Sequence[Value], camera: Camera) -> list[Value]:
    """Return the answer to a request; `[nak]` for other interfaces, `[fail]` for other requests."""
    match request:
        case ["visr", "get", "w"]:
            return [_VISUAL, Vocab("w"), Vocab("is"), camera.width]
        case ["visr", "get", "h"]:
            return [_VISUAL, Vocab("h"), Vocab("is"), camera.height]
        case ["visr", *_]:
            return [Vocab("fail")]
    return [Vocab("nak")]
