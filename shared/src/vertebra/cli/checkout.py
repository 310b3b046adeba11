"""The checkout that this package is installed from, and what `up` keeps in it."""

from __future__ import annotations

import os
from pathlib import Path

from vertebra.errors import ConfigError


def checkout() -> Path:
    """Return the folder of the workspace.

    Raises:
        ConfigError: This package is installed without one, as it is in a container.
    """
    root = Path(__file__).resolve().parents[4]
    if not (root / "compose.yaml").is_file():
        raise ConfigError(
            f"this command needs a checkout of Vertebra, and there is no compose.yaml in {root}; "
            "run ./vertebra inside a checkout"
        )
    return root


def state_folder(root: Path, name: str) -> Path:
    """Return a folder (run, log, models) below `VERTEBRA_STATE`, by default `.vertebra`."""
    folder = (root / (os.environ.get("VERTEBRA_STATE") or ".vertebra") / name).resolve()
    folder.mkdir(parents=True, exist_ok=True)
    return folder
