"""Sounds from the web: WAV files become audio chunks."""

from __future__ import annotations

import io
import wave
from typing import Final

from vertebra.messages import Array, AudioChunk
from vertebra_gateway.problems import InputRefusedError

_SAMPLE_BYTES: Final = 2


def read_wav(data: bytes) -> AudioChunk:
    """Return the sound in a WAV file; raise `InputRefusedError` unless it has 16-bit samples."""
    try:
        with wave.open(io.BytesIO(data)) as file:
            if file.getsampwidth() != _SAMPLE_BYTES:
                raise InputRefusedError(f"samples of {8 * file.getsampwidth()} bits; send 16 bits")
            channels, rate_hz = file.getnchannels(), file.getframerate()
            samples = file.readframes(file.getnframes())
    except (wave.Error, EOFError) as error:
        raise InputRefusedError(f"the body is no WAV file: {error}") from error
    instants = len(samples) // (_SAMPLE_BYTES * channels)
    if not instants:
        raise InputRefusedError("the WAV file holds no sound")
    whole = samples[: instants * _SAMPLE_BYTES * channels]
    return AudioChunk(samples=Array(whole, "<i2", (instants, channels)), rate_hz=rate_hz)
