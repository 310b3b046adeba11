"""Run a command: `./vertebra COMMAND`, or `python -m vertebra.cli COMMAND`."""

from __future__ import annotations

import argparse
import os
import sys

from vertebra import __version__
from vertebra.cli import bench, call, check, doctor, echo, keys, pub, ros2, test, up, yarp
from vertebra.errors import ConfigError, NameMappingError, VertebraError

_EXIT_INTERRUPTED = 130


def main() -> int:
    """Run the command in `sys.argv`; return the exit status: 0 well, 1 failed, 2 misused."""
    parser = argparse.ArgumentParser(
        prog="vertebra", description="One backbone for a lab's robots: run, watch and script it."
    )
    parser.add_argument("--version", action="version", version=__version__)
    commands = parser.add_subparsers(metavar="COMMAND", required=True)
    for module in (up, doctor, keys, echo, pub, call, yarp, ros2, test, check, bench):
        module.add_to(commands)
    arguments, others = parser.parse_known_args()
    if others and "pytest_arguments" not in arguments:
        parser.error(f"unrecognized arguments: {' '.join(others)}")
    arguments.pytest_arguments = others
    try:
        status: int = arguments.run(arguments)
        sys.stdout.flush()
    except (ConfigError, NameMappingError) as error:
        return _fail(error, 2)
    except VertebraError as error:
        return _fail(error, 1)
    except KeyboardInterrupt:
        return _EXIT_INTERRUPTED
    except BrokenPipeError:  # the reader of our output has seen enough
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        return 0
    return status


def _fail(error: VertebraError, status: int) -> int:
    for line in str(error).splitlines():
        sys.stderr.write(f"vertebra: {line}\n")
    return status


if __name__ == "__main__":
    sys.exit(main())
