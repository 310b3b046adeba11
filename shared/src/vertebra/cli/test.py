"""`test`: run every test that this machine can run."""

from __future__ import annotations

import argparse
import subprocess
import sys

from vertebra.cli.checkout import checkout


def add_to(commands: argparse._SubParsersAction[argparse.ArgumentParser]) -> None:
    """Describe the command."""
    parser = commands.add_parser(
        "test",
        usage="%(prog)s [-h] [PYTEST ARGUMENT ...]",
        help="run the tests; what was skipped, and how to enable it, is listed at the end",
        description="Run pytest, without arguments on all lanes but bench. In lanes that "
        "VERTEBRA_REQUIRE names (live,e2e,browser) a skip is a failure.",
    )
    parser.set_defaults(run=run, pytest_arguments=[])


def run(arguments: argparse.Namespace) -> int:
    """Run pytest and return its exit status."""
    asked = arguments.pytest_arguments or ["-m", "not bench"]
    return subprocess.run(  # noqa: S603 - our own interpreter; the arguments are the user's
        [sys.executable, "-m", "pytest", *asked], cwd=checkout(), check=False
    ).returncode
