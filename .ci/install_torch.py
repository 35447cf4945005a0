"""Install torch as a CPU build, before anything else pulls it in.

The plain package index serves Linux a build with gigabytes of GPU libraries that nothing here
needs. pip is therefore first asked what it would take from the places it is configured for; a CPU
build is taken from there, and otherwise PyTorch's own CPU index is used. Asking downloads metadata
only. Usage: ``python .ci/install_torch.py``, with the interpreter of the environment to fill.
"""

from __future__ import annotations

import json
import re
import subprocess
import sys
from importlib import metadata
from typing import Any

VERSION = "2.13.0"
REQUIREMENT = f"torch=={VERSION}"
CPU_INDEX = "https://download.pytorch.org/whl/cpu"
PIP = [sys.executable, "-m", "pip"]


def is_installed() -> bool:
    """Whether this interpreter already has the version, whatever its build."""
    try:
        return metadata.version("torch").partition("+")[0] == VERSION
    except metadata.PackageNotFoundError:
        return False


def ask_pip() -> dict[str, Any] | None:
    """pip's report of what it would install from its configured places; None if it finds nothing."""
    command = [*PIP, "install", "--dry-run", "--quiet", "--no-deps", "--ignore-installed", "--report", "-"]
    answer = subprocess.run([*command, REQUIREMENT], capture_output=True, text=True, check=False)
    return json.loads(answer.stdout) if answer.returncode == 0 else None


def needs_gpu_libraries(requirement: str, machine: str) -> bool:
    """Whether one requirement of torch pulls GPU libraries onto a Linux machine.

    Wheels of one release may share their requirements and tell the machines apart by a marker.
    """
    if not re.match(r"(nvidia|cuda)-", requirement):
        return False
    machines = re.findall(r"platform_machine\s*==\s*[\"'](\w+)[\"']", requirement)
    return not machines or machine in machines


def offers_cpu_build(report: dict[str, Any] | None) -> bool:
    """Whether pip's report (format 1 of ``pip install --report``) is that of a CPU build.

    A local version label decides where there is one ("2.13.0+cpu", "2.13.0+cu130"). Without a label,
    macOS and Windows builds are CPU builds, and a Linux build is one if it needs no GPU libraries.
    """
    if report is None or not report["install"]:
        return False
    torch, system = report["install"][0]["metadata"], report["environment"]
    label = torch["version"].partition("+")[2]
    if label:
        return label == "cpu"
    if system["sys_platform"] in ("darwin", "win32"):
        return True
    machine = system["platform_machine"]
    return not any(needs_gpu_libraries(one, machine) for one in torch.get("requires_dist", []))


def install_command(report: dict[str, Any] | None) -> list[str]:
    """The arguments of pip that install a CPU build, given pip's report."""
    source = [] if offers_cpu_build(report) else ["--index-url", CPU_INDEX]
    return ["install", *source, REQUIREMENT]


def main() -> int:
    """Install torch if it is missing; return 0, or 1 after one sentence on what went wrong."""
    if is_installed():
        print(f"torch {VERSION} is already there")
        return 0
    arguments = install_command(ask_pip())
    print(f"installing torch {VERSION} (CPU build): pip {' '.join(arguments)}", flush=True)
    if subprocess.run([*PIP, *arguments], check=False).returncode == 0:
        return 0
    print(
        f"OffroadBekker could not install the CPU build of torch {VERSION} for Python "
        f"{sys.version_info.major}.{sys.version_info.minor} (pip's reason is above): check the network, or "
        f"put its wheel where pip looks (PIP_FIND_LINKS=FOLDER).",
        file=sys.stderr,
    )
    return 1


if __name__ == "__main__":
    sys.exit(main())
