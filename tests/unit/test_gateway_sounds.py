"""WAV files from the web."""

from __future__ import annotations

import io
import wave

import pytest

from vertebra_gateway.problems import InputRefusedError
from vertebra_gateway.sounds import read_wav


def wav(samples: bytes, *, channels: int = 1, sample_bytes: int = 2, rate_hz: int = 8000) -> bytes:
    file = io.BytesIO()
    with wave.open(file, "wb") as writer:
        writer.setnchannels(channels)
        writer.setsampwidth(sample_bytes)
        writer.setframerate(rate_hz)
        writer.writeframes(samples)
    return file.getvalue()


def test_samples_keep_their_channels_and_rate() -> None:
    chunk = read_wav(wav(bytes(range(16)), channels=2, rate_hz=44100))
    assert (chunk.samples.shape, chunk.samples.dtype, chunk.rate_hz) == ((4, 2), "<i2", 44100)
    assert bytes(chunk.samples.data) == bytes(range(16))


@pytest.mark.parametrize(
    ("data", "words"),
    [
        (b"", "no WAV file"),
        (b"{}", "no WAV file"),
        (wav(b"")[:30], "no WAV file"),
        (wav(b""), "no sound"),
        (wav(bytes(8), sample_bytes=1), "8 bits; send 16"),
    ],
)
def test_what_is_no_sound_is_refused(data: bytes, words: str) -> None:
    with pytest.raises(InputRefusedError, match=words):
        read_wav(data)


def test_every_truncation_is_refused_or_shorter() -> None:
    whole = wav(bytes(40))
    for length in range(len(whole)):
        try:
            chunk = read_wav(whole[:length])
        except InputRefusedError:
            continue
        assert chunk.samples.shape[0] < 20
