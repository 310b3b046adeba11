"""What the speaker plays, and what the microphone hears of it: the robot hears itself."""

from __future__ import annotations

from array import array
from typing import Final

import numpy as np
from numpy.typing import NDArray

from vertebra.errors import CommandRefusedError
from vertebra.yarp.objects import Sound

RATE_HZ: Final = 16_000
CHUNK: Final = 1_600
MAX_WAITING: Final = 20 * RATE_HZ


class Room:
    """A quiet room with a speaker and a microphone."""

    def __init__(self) -> None:
        self._waiting: NDArray[np.int16] = np.empty(0, np.int16)

    def play(self, sound: Sound) -> None:
        """Play a sound after those that still play.

        Raises:
            CommandRefusedError: It would make the speaker talk for more than 20 s.
        """
        if sound.channels < 1 or sound.frequency_hz < 1 or not len(sound.samples):
            raise CommandRefusedError("a sound without samples, channels or frequency")
        instants = len(sound.samples) // sound.channels
        first = np.asarray(sound.samples, np.int16)[:instants]  # channels come one after the other
        heard = np.arange(instants * RATE_HZ // sound.frequency_hz)
        if len(self._waiting) + len(heard) > MAX_WAITING:
            raise CommandRefusedError(
                f"the speaker has {len(self._waiting) / RATE_HZ:.1f} s to say"
            )
        played = first[heard * sound.frequency_hz // RATE_HZ]
        self._waiting = np.concatenate((self._waiting, played))

    def hear(self) -> Sound:
        """Return what the microphone hears in the next tenth of a second."""
        heard, self._waiting = self._waiting[:CHUNK], self._waiting[CHUNK:]
        samples = array("h", heard.tobytes())
        samples.extend([0] * (CHUNK - len(samples)))
        return Sound(RATE_HZ, 1, samples)
