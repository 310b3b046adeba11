"""`bench`: measure, side by side with what others have."""

from __future__ import annotations

import argparse
import subprocess
import sys

from vertebra.cli.checkout import checkout


def add_to(commands: argparse._SubParsersAction[argparse.ArgumentParser]) -> None:
    """Describe the command."""
    parser = commands.add_parser(
        "bench",
        usage="%(prog)s [-h] [PYTEST ARGUMENT ...]",
        help="measure, side by side with what others have",
        description="Run the lane bench of the tests, which prints its measurements.",
    )
    parser.set_defaults(run=run, pytest_arguments=[])


def run(arguments: argparse.Namespace) -> int:
    """Run the lane `bench` and return the exit status of pytest."""
    command = [sys.executable, "-m", "pytest", "-m", "bench", "-s", "-p", "no:randomly"]
    return subprocess.run(  # noqa: S603 - our own interpreter; the arguments are the user's
        [*command, *arguments.pytest_arguments, "tests/bench"], cwd=checkout(), check=False
    ).returncode
