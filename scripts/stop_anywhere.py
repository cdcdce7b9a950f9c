"""Stop `run`, `evaluate` and `study` at random moments, by signals and full disks, and look at what is left.

What is on disk must be readable, nothing may say that it is finished which is not, no command may end in a traceback,
and what is done again afterwards must equal what was never disturbed, bit for bit. Full disks are file systems in
memory, which only the superuser can mount; others do without.
"""

from __future__ import annotations

import argparse
import json
import os
import random
import shutil
import signal
import subprocess
import sys
import tempfile
import time
from pathlib import Path
from zipfile import ZipFile

from fvslam_graph.runs.run_folder import read_run

WORLD = "synthetic:uav?frames=12&size=160x120"
STUDY = f'sequences: ["{WORLD}"]\nmodes: [vo, graph]\nseeds: 1\n'
LEFT = {  # what a command leaves that depends on its input alone
    "run": ["trajectory_online.tum", "trajectory_smoothed.tum", "covariances.npz", "graph.gtsam", "landmarks.csv"],
    "evaluate": ["metrics.json", "reference.tum"],
    "study": ["results.csv"],
}
DISK = (8, 300)  # KB, beside the run of which there is an evaluation


def main() -> None:
    """Do it as often as asked for, and say how often what came out."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--moments", type=int, default=20, help="of each command")
    parser.add_argument("--seed", type=int, default=0)
    arguments = parser.parse_args()
    signal.signal(signal.SIGINT, signal.default_int_handler)  # which a shell's "&" lets commands ignore
    chance = random.Random(arguments.seed)
    kinds = ["SIGKILL", "SIGTERM", "SIGINT", *(["full disk"] if os.geteuid() == 0 else [])]
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        (folder / "study.yaml").write_text(STUDY)
        for command in LEFT:
            begin = time.monotonic()
            code, said = execute(command, folder, folder / f"undisturbed-{command}")
            assert code == 0, said
            seconds = time.monotonic() - begin
            for moment in range(arguments.moments):
                kind = kinds[moment % len(kinds)]
                disturb(command, kind, folder, chance, seconds)
    print("nothing was lost")


def disturb(command: str, kind: str, folder: Path, chance: random.Random, seconds: float) -> None:
    """Stop a command once, look, and let it come to its end."""
    out, whole = folder / "out", folder / f"undisturbed-{command}"
    out.mkdir()
    full = kind == "full disk"
    held = 4 * sum(-(-file.stat().st_size // 4096) for file in (folder / "undisturbed-run").iterdir())
    size, moment = chance.randint(*DISK) + (held if command == "evaluate" else 0), chance.uniform(0.1, 1.0) * seconds
    if full:
        subprocess.run(["mount", "-t", "tmpfs", "-o", f"size={size}k", "tmpfs", out], check=True)
    target = out / whole.name
    try:
        if command == "evaluate":
            shutil.copytree(folder / "undisturbed-run", target)
        code, said = execute(command, folder, target, None if full else (getattr(signal, kind), moment))
        print(f"{command}, {kind} {f'{size} KB' if full else f'{moment:.1f} s'}: {code} {said[-120:]}", flush=True)
        died = not full and code < 0  # killed, or before Python has come to our own handler, or after it
        assert died or ("Traceback" not in said and code in (0, 1, 130)), (code, said)
        if code == 0:
            require_equal(command, target, whole)
        look(target, folder / "undisturbed-run")
    finally:
        if full:
            kept = shutil.copytree(out, folder / "kept")
            subprocess.run(["umount", out], check=True)
            out.rmdir()
            kept.rename(out)
    code, said = execute(command, folder, target)
    assert code == 0, said
    require_equal(command, target, whole)
    shutil.rmtree(out)


def execute(
    command: str, folder: Path, target: Path, stop: tuple[signal.Signals, float] | None = None
) -> tuple[int, str]:
    """Exit code and what was said, of a command that is sent a signal after so many seconds."""
    if command == "evaluate" and not target.exists():
        shutil.copytree(folder / "undisturbed-run", target)
    words = {
        "run": ["run", WORLD, "--mode", "graph", "--out", target],
        "evaluate": ["evaluate", target],
        "study": ["study", folder / "study.yaml", "--out", target, "--workers", "1"],
    }[command]
    process = subprocess.Popen(
        [sys.executable, "-m", "fvslam_graph", *map(str, words)],
        stdout=subprocess.DEVNULL,
        stderr=subprocess.PIPE,
        text=True,
    )
    if stop is not None:
        time.sleep(stop[1])
        process.send_signal(stop[0])
    _, said = process.communicate()
    return process.returncode, " ".join(said.split())


def require_equal(command: str, target: Path, whole: Path) -> None:
    """That a command has left what it leaves undisturbed."""
    for name in LEFT[command]:
        a, b = ((folder / name).read_bytes() for folder in (target, whole))
        assert a == b, f"{target / name} is not as if nothing had happened"


def look(target: Path, run: Path) -> None:
    """That all that is there can be read, and what says that it is finished is."""
    for info in target.rglob("run.json"):
        found = read_run(info.parent)
        if found.info["status"] == "finished" and found.info["mode"] == "graph":
            require_equal("run", info.parent, run)
    for file in [*target.rglob("metrics.json"), *target.rglob("row_*.json")]:
        json.loads(file.read_text())
    for file in target.rglob("*.zip"):
        assert ZipFile(file).testzip() is None


if __name__ == "__main__":
    main()
