"""Whatever is wrong with what a user hands over: one sentence, and never a wrong number without a word.

Each example takes a small input, spoils one of its files, and runs a command on it. An example is the same on every
machine: `pytest tests/fuzz -k kitti-17`. FVSLAM_FUZZ=50, as in `make fuzz`, makes fifty times as many.
"""

import os
import random
import re
import resource
import shutil
import signal
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import pytest

from fvslam_graph.evaluation.runs import evaluation_of
from fvslam_graph.runs.run_folder import read_run
from fvslam_graph.sequences.open import open_sequence

TIMES = int(os.environ.get("FVSLAM_FUZZ", "1"))
SECONDS, BYTES = 60, 2_000_000_000

NUMBER = re.compile(r"(?<![\w.+-])[-+]?\d+(?:\.\d+)?(?:[eE][-+]?\d+)?(?![\w.])")
BINARY = (".png", ".avi", ".bag", ".mcap", ".db3", ".npz", ".gtsam")


Facts = tuple[dict[str, Any], tuple[str, ...]]
"""What must not change silently, by name, and the notes."""


def recording(path: Path) -> Facts:
    sequence = open_sequence(path)
    for index in range(len(sequence)):
        sequence.load(index)
    camera, truth = sequence.camera, sequence.ground_truth
    known = {"K": camera.K, "size": (camera.width, camera.height), "stamps": sequence.stamps}
    if truth is not None:
        known |= {"truth": truth.matrices, "times of truth": truth.stamps}
    return known, sequence.notes


def evaluation(estimate: Path, reference: Path | None = None) -> Facts:
    result = evaluation_of(estimate, reference)
    errors = {name: error.stats["rmse"] for name, error in result.errors.items()}
    return errors | {"poses": len(result.pairs.indices)}, result.notes


class Subject(NamedTuple):
    """What is fuzzed.

    Attributes:
        count: Examples; less than one is for `make fuzz`.
        folder: Of the originals.
        commands: One is chosen for each example.
        spoilt: Pattern of the files that are spoilt.
        facts: What the files say; None where that is not compared.
    """

    count: float
    folder: str
    commands: tuple[str, ...]
    spoilt: str
    facts: Callable[[Path], Facts] | None


def layout(count: int, folder: str, path: str = "", spoilt: str = r".*\.(txt|csv|yaml|tum)") -> Subject:
    info, run = f"info {{at}}{path}", f"run {{at}}{path} --out {{out}} --set scale.source=map"
    return Subject(count, folder, (info, info, info, run), spoilt, lambda at: recording(Path(f"{at}{path}")))


def pair(estimate: str, reference: str) -> Subject:
    command = f"evaluate {{at}}/{estimate} --reference {{at}}/{reference}"
    spoilt = f"{estimate}|{reference}"
    return Subject(20, "trajectories", (command,), spoilt, lambda at: evaluation(at / estimate, at / reference))


OF_A_RUN = r"run/.*\.(tum|csv|json|npz)"
SETTINGS = "run {at}/recording --config {at}/config.yaml --out {out}"
EXPORTS = tuple(
    f"export {{at}}/run --to {format} --out {{out}}"
    for format in ("csv", "ros2", "g2o", "geojson --origin 1,2,3", "colmap --smoothed")
)
STUDY = "study {at}/study.yaml --out {out} --workers 1"
TRUTH = "recording/groundtruth.tum"
COMPARE = f"compare {{at}}/recording --modes vo --seeds 1 --external X={{at}}/{TRUTH} --out {{out}}"
SUBJECTS = {
    "folder": layout(30, "folder"),
    "kitti": layout(30, "kitti"),
    "kitti_raw": layout(30, "kitti_raw", "/2011_09_26/2011_09_26_drive_0007_sync"),
    "karlsruhe": layout(25, "karlsruhe"),
    "euroc": layout(30, "euroc"),
    "tum": layout(30, "tum"),
    "video": layout(15, "video", "/flight.avi"),
    "telemetry": layout(15, "video", "/flight.avi", r".*\.srt"),
    "images": layout(20, "folder", "", r".*\.png")._replace(facts=None),
    "film": layout(10, "video", "/flight.avi", r".*\.avi")._replace(facts=None),
    "ros1": layout(10, "ros1", "/flight.bag", r".*\.bag")._replace(facts=None),
    "mcap": layout(10, "mcap", "/flight", r".*\.(mcap|yaml)")._replace(facts=None),
    "sqlite": layout(10, "sqlite", "/flight", r".*\.(db3|yaml)")._replace(facts=None),
    "self-calibration": Subject(5, "folder", ("calibrate {at} --out {out}",), ".*", None),
    "tum-tum": pair("estimate.tum", "reference.tum"),
    "kitti-tum": pair("estimate.kitti", "reference.tum"),
    "tum-asl": pair("estimate.tum", "reference.csv"),
    "run": Subject(20, "run", ("evaluate {at}/run",), r"run/.*", lambda at: evaluation(at / "run")),
    "plot": Subject(2, "run", ("plot {at}/run --out {out}",), OF_A_RUN, None),
    "export": Subject(6, "run", EXPORTS, r"run/.*", None),
    "settings": Subject(15, "settings", (SETTINGS,), r"config\.yaml", None),
    "study": Subject(12, "study", (STUDY,), r"study\.yaml", None),
    "external": Subject(0.2, "study", (COMPARE,), TRUTH, None),
}


# How files are spoilt. What is HARMLESS changes nothing; what is DAMAGE is refused or noted where it changes anything;
# OTHER input may be somebody else's good one, and only has to end well.
def _harmless(data: bytes, rng: random.Random) -> tuple[str, bytes]:
    return rng.choice(
        [
            ("BOM", b"\xef\xbb\xbf" + data),
            ("CRLF", data.replace(b"\n", b"\r\n")),
            ("blank lines at the end", data + b"\n\n"),
            ("trailing blanks", data.replace(b"\n", b" \n")),
        ]
    )


def _number(data: bytes, rng: random.Random, values: tuple[str, ...]) -> tuple[str, bytes]:
    text = data.decode()
    found = list(NUMBER.finditer(text))
    if not found:
        return "nothing", data
    match, value = rng.choice(found), rng.choice(values)
    line = text.count("\n", 0, match.start()) + 1
    return f"line {line}: {match[0]} is {value!r}", (text[: match.start()] + value + text[match.end() :]).encode()


def _damage(data: bytes, rng: random.Random) -> tuple[str, bytes]:
    where = rng.randrange(len(data) + 1)
    return rng.choice(
        [
            *5 * [_number(data, rng, ("nan", "inf", "-inf", "1e400", "", "null", ".", "x"))],
            ("NUL", data[:where] + b"\0" + data[where:]),
            ("zeros from a byte on", data[:where] + bytes(len(data) - where)),
            ("UTF-16", data.decode().encode("utf-16")),
            ("Latin-1", "Zürich\n".encode("latin-1") + data),
            ("empty", b""),
            ("noise", rng.randbytes(200)),
        ]
    )


def _other(data: bytes, rng: random.Random) -> tuple[str, bytes]:
    lines, where = data.splitlines(keepends=True) or [b""], rng.randrange(len(data) + 1)
    a, b = sorted(rng.choices(range(len(lines)), k=2))
    swapped = [*lines[:a], lines[b], *lines[a + 1 : b], lines[a], *lines[b + 1 :]] if a < b else lines
    return rng.choice(
        [
            *4 * [_number(data, rng, ("0", "-1", "1e300", "-1e300", "1e-300", "99999999999999999999", "0.5"))],
            ("truncated", data[:where]),
            ("no last line end", data.removesuffix(b"\n")),
            (
                f"a byte at {where} flipped",
                data[:where] + bytes(b ^ 1 << rng.randrange(8) for b in data[where:][:1]) + data[where + 1 :],
            ),
            (f"line {a + 1} dropped", b"".join(lines[:a] + lines[a + 1 :])),
            (f"line {a + 1} twice", b"".join(lines[: a + 1] + lines[a:])),
            (f"lines {a + 1} and {b + 1} swapped", b"".join(swapped)),
            ("deep nesting", b"[" * 3000 + data),
            ("a date that is none", data + b"\nday: 2024-02-30\n"),
            ("an alias of itself", data + b"\nself: &a [*a]\n"),
            ("an int that is none", data + b'\nx: !!int "abc"\n'),
            ("a tag", data + b"\nx: !!python/object/apply:os.getcwd []\n"),
        ]
    )


def _replaced(path: Path, rng: random.Random) -> str:
    kind = rng.choice(["missing", "renamed", "a folder", "a pipe", "a circle of links", "a device", "a dead link"])
    path.rename(path.with_name(f"{path.name}.bak")) if kind == "renamed" else path.unlink()
    if kind == "a folder":
        path.mkdir()
    elif kind == "a pipe":
        os.mkfifo(path)
    elif kind != "missing" and kind != "renamed":
        path.symlink_to({"a circle of links": path, "a device": "/dev/zero", "a dead link": "nowhere"}[kind])
    return kind


def spoil(path: Path, rng: random.Random) -> tuple[str, str]:
    """Spoil a file; says of which class that is, and what was done."""
    binary = path.suffix in BINARY
    kind = rng.choices(["HARMLESS", "DAMAGE", "OTHER", "GONE"], [0 if binary else 2, 0 if binary else 5, 4, 2])[0]
    if kind == "GONE":
        return kind, _replaced(path, rng)
    data = path.read_bytes()
    if binary:
        where = rng.randrange(len(data))
        what, new = rng.choice(
            [
                ("truncated", data[:where]),
                ("empty", b""),
                ("noise", rng.randbytes(200)),
                ("bytes flipped", data[:where] + rng.randbytes(20) + data[where + 20 :]),
                ("zeros from a byte on", data[:where] + bytes(len(data) - where)),
                ("more after the end", data + rng.randbytes(20)),
            ]
        )
    else:
        what, new = {"HARMLESS": _harmless, "DAMAGE": _damage, "OTHER": _other}[kind](data, rng)
    path.write_bytes(new)
    return kind, what


class TooLong(BaseException):
    """A minute is over; no `except` of what is tested catches it."""


@contextmanager
def limits() -> Iterator[None]:
    """No minute, no two gigabytes more than before."""

    def stop(*_: object) -> None:
        raise TooLong

    now = int(Path("/proc/self/statm").read_text().split()[0]) * resource.getpagesize()
    before = resource.getrlimit(resource.RLIMIT_AS)
    handler = signal.signal(signal.SIGALRM, stop)
    signal.alarm(SECONDS)
    resource.setrlimit(resource.RLIMIT_AS, (now + BYTES, before[1]))
    try:
        yield
    finally:
        signal.alarm(0)
        signal.signal(signal.SIGALRM, handler)
        resource.setrlimit(resource.RLIMIT_AS, before)


def ended_well(outcome: Any) -> None:
    """Results without NaN, or one sentence."""
    code, out, err = outcome
    assert code in (0, 1, 2) and "Traceback" not in err and "Warning" not in err, err
    if code == 0:
        assert not re.search(r"(?<![\w.])[-+]?(nan|inf)(?![\w.])", out, re.IGNORECASE), out
    elif code == 1:
        *before, sentence = err.splitlines()  # the libraries of images and videos may say something before
        assert sentence.startswith("fvslam: ") and len(sentence) < 1000, err
        assert not any(line.startswith("fvslam: ") for line in before), err


def same(a: Any, b: Any) -> bool:
    return np.shape(a) == np.shape(b) and np.allclose(a, b, rtol=1e-6, atol=1e-6)


EXAMPLES = [f"{name}-{number}" for name, subject in SUBJECTS.items() for number in range(int(subject.count * TIMES))]


@pytest.mark.parametrize("example", EXAMPLES)
def test_fuzz(originals, tmp_path, monkeypatch, fvslam, example):
    rng, name = random.Random(example), example.rpartition("-")[0]
    subject = SUBJECTS[name]
    at = shutil.copytree(originals / subject.folder, tmp_path / "at")
    monkeypatch.chdir(tmp_path)
    files = {str(path.relative_to(at)): path for path in sorted(at.rglob("*")) if path.is_file()}
    file = rng.choice([file for file in files if re.fullmatch(subject.spoilt, file)])
    command = rng.choice(subject.commands)
    words = command.format(at=at, out=tmp_path / "out").split()
    before = subject.facts(at) if subject.facts else None
    kind, what = spoil(files[file], rng)
    try:
        with limits():
            outcome = fvslam(*words)
            ended_well(outcome)
            if kind == "HARMLESS":
                original = shutil.copytree(originals / subject.folder, tmp_path / "original")
                assert outcome.code == fvslam(*command.format(at=original, out=tmp_path / "before").split()).code
            if outcome.code == 0 and words[0] == "run":
                assert len(read_run(tmp_path / "out").online) > 0
            if outcome.code == 0 and before is not None:
                compared(kind, before, subject.facts(at))
    except BaseException as error:
        error.add_note(f"{kind}, {file}: {what}; fvslam {' '.join(words)}")
        raise


def compared(kind: str, before: Facts, after: Facts) -> None:
    """What the spoilt input says, beside what it said before."""
    changed = [key for key in before[0] if key in after[0] and not same(before[0][key], after[0][key])]
    if kind == "HARMLESS" or (kind in ("DAMAGE", "GONE") and set(after[1]) <= set(before[1])):
        assert not changed, f"{changed} changed without a word"


@pytest.mark.parametrize(
    "outcome",
    [(3, "", ""), (0, "APE nan m", ""), (0, "-inf", ""), (1, "", "Traceback: ..."), (1, "", "fvslam: a\nb\n")],
)
def test_what_does_not_end_well(outcome):
    with pytest.raises(AssertionError):
        ended_well(outcome)


def test_a_silent_change_is_noticed():
    before, after = ({"K": np.eye(3)}, ("a",)), {"K": 2 * np.eye(3)}
    compared("DAMAGE", before, (after, ("a", "b")))
    compared("OTHER", before, (after, ()))
    for kind in ("HARMLESS", "DAMAGE", "GONE"):
        with pytest.raises(AssertionError, match="changed without a word"):
            compared(kind, before, (after, ("a",)))


ODD = (
    "",
    " ",
    "nan",
    "inf",
    "-1",
    "0",
    "1e400",
    "1000000000",
    "é🙂",
    "..",
    300 * "a",
    "[",
    "$x^{$",
    "null",
    "1:2:3",
    ":",
    "x=y",
)
OPTIONS = {
    "run {root}/folder --out {out}": (
        "mode preset config set seed frames stride image-scale camera-height camera-pitch recalibration topic "
        "fov telemetry telemetry-offset start-pose ground-plane altimeter gnss gnss-sigma"
    ),
    "live {root}/folder --patience 0.01 --out {out}": (
        "camera fov format mode preset config set seed camera-height camera-pitch"
    ),
    "info {root}/folder": "camera-height camera-pitch topic fov telemetry telemetry-offset",
    "calibrate {root}/folder --out {out}": "frames stride topic fov",
    "calibrate {root}/folder/images --checkerboard 5x4 --square 0.1": "checkerboard square charuco marker out",
    "evaluate {root}/run/run": "reference align time-offset",
    "plot {root}/folder": "out align landmarks",
    "export {root}/run/run --to kml --out {out}": "to out origin gnss",
    "compare {root}/absent --out {out}": "modes seeds preset set external align workers",
    "study {root}/study/study.yaml --out {out}": "workers scheduler",
}
COMMANDS = ("run", "info", "calibrate", "evaluate", "plot", "export", "compare", "study")
ARGUMENTS = [
    *(
        (command, f"--{option}", odd)
        for command, options in OPTIONS.items()
        for option in options.split()
        for odd in ODD
    ),
    *((command, "", odd) for command in COMMANDS for odd in ODD),
]


@pytest.mark.parametrize(
    ("command", "option", "odd"), random.Random(0).sample(ARGUMENTS, min(120 * TIMES, len(ARGUMENTS)))
)
def test_odd_arguments(originals, tmp_path, monkeypatch, fvslam, command, option, odd):
    monkeypatch.chdir(tmp_path)
    words = command.format(root=originals, out=tmp_path / "out").split()
    with limits():
        ended_well(fvslam(*words, *([option] if option else []), odd))
