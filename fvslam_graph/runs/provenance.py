"""Under which circumstances a run was made: versions, revision, machine, memory."""

import contextlib
import os
import platform
import subprocess
from functools import cache
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path
from typing import Any

from fvslam_graph import __version__

_RECORDED = {"gtsam": "gtsam", "numpy": "numpy", "opencv": "opencv-python-headless", "poselib": "poselib"}


def provenance() -> dict[str, Any]:
    """Versions of what computed the run, the git revision (only in a checkout) and the machine."""
    facts: dict[str, Any] = {
        "versions": library_versions(),
        "machine": {"platform": platform.platform(), "cores": os.cpu_count()},
    }
    if (revision := _git_revision()) is not None:
        facts["git"] = revision
    return facts


@cache  # each job of a study asks
def library_versions() -> dict[str, str | None]:
    """The numbers of this package, of Python and of the libraries that compute."""
    libraries = {name: _version(package) for name, package in _RECORDED.items()}
    return {"fvslam_graph": __version__, "python": platform.python_version(), **libraries}


def _version(package: str) -> str | None:
    """Its version; None where it is not installed, as PoseLib on ARM."""
    try:
        return version(package)
    except PackageNotFoundError:
        return None


def peak_memory_mb() -> float:
    """Largest resident memory of this process since `forget_peak_memory`, megabytes; NaN where no system tells."""
    # `getrusage` counts what the process that began this one had in memory.
    with contextlib.suppress(OSError, ValueError, StopIteration):
        lines = Path("/proc/self/status").read_text().splitlines()
        return float(next(line.split()[1] for line in lines if line.startswith("VmHWM"))) * 1024 / 1e6
    try:
        import resource
    except ImportError:  # Windows
        return float("nan")
    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1e6  # macOS counts bytes


def forget_peak_memory() -> None:
    """Let `peak_memory_mb` begin anew, so that a run does not answer for those before it; Linux only."""
    with contextlib.suppress(OSError):
        Path("/proc/self/clear_refs").write_text("5")


def seconds_without_core() -> float:
    """Seconds for which this process has waited for a core that others had; NaN on systems that do not tell."""
    with contextlib.suppress(OSError, ValueError, IndexError):
        return float(Path("/proc/self/schedstat").read_text().split()[1]) / 1e9
    return float("nan")


def _git_revision() -> str | None:
    """Commit of the source, with "-dirty" where it was changed since; None outside of a checkout."""
    root = Path(__file__).parents[2]
    if not (root / ".git").exists():
        return None
    command = ["git", "-C", str(root), "describe", "--always", "--dirty", "--abbrev=40", "--exclude", "*"]
    try:
        return subprocess.run(command, capture_output=True, text=True, check=True).stdout.strip()
    except (OSError, subprocess.CalledProcessError):
        return None
