"""One LiteRT model: float tensors in, float tensors out. Nothing else here imports the runtime."""

from __future__ import annotations

import numpy as np
from ai_edge_litert.interpreter import Interpreter  # type: ignore[import-untyped]
from numpy.typing import NDArray

from vertebra.errors import ConfigError

Tensor = NDArray[np.float32]


class LiteRtModel:
    """A loaded model with one input. It is used by one thread at a time.

    Args:
        content: The bytes of the `.tflite` file.
        name: What to call it in errors.
        input_shape: What the caller will feed.
        output_shapes: What the caller expects back, in the order it wants them.

    Raises:
        ConfigError: The file is no such model.
    """

    def __init__(
        self,
        content: bytes,
        *,
        name: str,
        input_shape: tuple[int, ...],
        output_shapes: tuple[tuple[int, ...], ...],
    ) -> None:
        try:
            # One thread: several services share few cores, and spinning threads lose there.
            self._interpreter = Interpreter(model_content=content, num_threads=1)
            self._interpreter.allocate_tensors()
        except (ValueError, RuntimeError) as error:
            raise ConfigError(f"model {name!r} is not a TensorFlow Lite model: {error}") from error
        inputs = {tuple(d["shape"]): d["index"] for d in self._interpreter.get_input_details()}
        outputs = {tuple(d["shape"]): d["index"] for d in self._interpreter.get_output_details()}
        if set(inputs) != {input_shape} or set(outputs) != set(output_shapes):
            raise ConfigError(
                f"model {name!r} maps {_shapes(inputs)} to {_shapes(outputs)}, but this backend "
                f"needs {_shapes([input_shape])} to {_shapes(output_shapes)}"
            )
        self._input = inputs[input_shape]
        self._outputs = [outputs[shape] for shape in output_shapes]

    def run(self, tensor: Tensor) -> list[Tensor]:
        """Return the outputs for one input, in the order of `output_shapes`."""
        self._interpreter.set_tensor(self._input, tensor)
        self._interpreter.invoke()
        return [self._interpreter.get_tensor(index) for index in self._outputs]


def _shapes(shapes: object) -> str:
    return ", ".join(sorted("x".join(map(str, shape)) for shape in shapes))  # type: ignore[attr-defined]
