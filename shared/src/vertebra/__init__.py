"""Vertebra: one backbone for a lab's robots."""

from typing import Final

__version__: Final = "0.1.0"
