#!/usr/bin/env python3
"""Pin every third-party dependency with hashes and without index addresses: <set>.txt here.

There is one set per service (its own needs and those of our distributions it names), one per
`*.in` file, `base` (the distribution `vertebra` alone) and `fleet` (everything that runs). All
sets are cut from one resolution: a package has the same version everywhere, and container images
share layers. Pins stay as they are unless a dependency asks for another; `--upgrade` moves all.
"""

from __future__ import annotations

import argparse
import re
import shutil
import subprocess
import sys
import tempfile
import tomllib
from pathlib import Path

HERE = Path(__file__).resolve().parent
ROOT = HERE.parents[1]
PYTHON_FLOOR = "3.11"
CONSTRAINTS = ["backports-strenum<1.3"]  # 1.3.1 is for Python < 3.11, a bound that uv ignores
HEADER = "# Made by deploy/requirements/compile.py from {source}. Do not edit.\n"


def distributions() -> dict[str, tuple[Path, list[str]]]:
    """Return folder and dependencies of each of our distributions, and of their extras, by name."""
    found = {}
    for file in [ROOT / "shared/pyproject.toml", *sorted(ROOT.glob("*/*/pyproject.toml"))]:
        if file.parent.name.startswith("_"):
            continue  # services/_template
        project = tomllib.loads(file.read_text(encoding="utf-8"))["project"]
        name = project["name"]
        found[name] = (file.parent, project.get("dependencies", []))
        for extra, needed in project.get("optional-dependencies", {}).items():
            found[f"{name}[{extra}]"] = (file.parent, [name, *needed])
    return found


def third_party(name: str, ours: dict[str, tuple[Path, list[str]]]) -> set[str]:
    """Return what distribution `name` needs from outside, also through others of ours."""
    needed: set[str] = set()
    for dependency in ours[name][1]:
        match = re.match(r"[A-Za-z0-9._-]+(\[[a-z0-9]+\])?", dependency)
        if match is None:
            sys.exit(f"{ours[name][0]}/pyproject.toml: {dependency!r} is not a dependency")
        if match[0] in ours:
            needed |= third_party(match[0], ours)
        else:
            needed.add(dependency)
    return needed


def needed_by_set() -> dict[str, tuple[str, str]]:
    """Return, for each set, where its requirements stand and the requirements as text."""
    ours = distributions()
    sets = {"base": ("shared/pyproject.toml", third_party("vertebra", ours))}
    everything = set(sets["base"][1])
    for name, (folder, _) in ours.items():
        needed = third_party(name, ours)
        everything |= needed
        if folder.parent.name == "services":
            sets[folder.name] = (f"services/{folder.name}/pyproject.toml", needed)
    sets["fleet"] = ("all distributions here", everything)
    texts = {name: (source, "\n".join(sorted(lines))) for name, (source, lines) in sets.items()}
    for file in sorted(HERE.glob("*.in")):
        texts[file.stem] = (f"deploy/requirements/{file.name}", f"-r {file}")
    return texts


def resolve(text: str, output: Path, *options: str) -> str:
    """Let uv pin `text`; versions in `output`, if it exists, are kept where they still fit."""
    uv = shutil.which("uv") or str(Path(sys.executable).with_name("uv"))
    command = [uv, "pip", "compile", "--quiet", "--universal", "--fork-strategy", "fewest",
               "--python-version", PYTHON_FLOOR, "--no-header", "--no-annotate",
               "--no-emit-index-url", "--no-emit-find-links", *options,
               "--output-file", str(output), "-"]  # fmt: skip
    subprocess.run(command, input=text, text=True, check=True, cwd=HERE)  # noqa: S603 - our own command
    return output.read_text(encoding="utf-8")


def main() -> None:
    """Write all sets."""
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument("--upgrade", action="store_true", help="take the newest versions")
    upgrade = parser.parse_args().upgrade
    sets = needed_by_set()
    with tempfile.TemporaryDirectory() as folder:
        common = Path(folder, "common.txt")
        if not upgrade:
            common.write_text(
                "".join(file.read_text(encoding="utf-8") for file in HERE.glob("*.txt"))
            )
        resolve("\n".join([*CONSTRAINTS, *(text for _, text in sets.values())]), common)
        for name, (source, text) in sets.items():
            pins = resolve(
                text, Path(folder, f"{name}.txt"), "--generate-hashes", "--constraint", str(common)
            )
            (HERE / f"{name}.txt").write_text(HEADER.format(source=source) + pins, encoding="utf-8")
    for stale in {file.stem for file in HERE.glob("*.txt")} - set(sets):
        (HERE / f"{stale}.txt").unlink()


if __name__ == "__main__":
    main()
