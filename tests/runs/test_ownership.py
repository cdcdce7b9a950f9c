"""What is not ours stays as it is, whatever command is told to write there; and names that differ stay apart."""

import json
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

from fvslam_graph.core.errors import ResultsError
from fvslam_graph.core.files import file_name, one_line, replacing, write_file
from fvslam_graph.runs.ownership import LOCK, MARK, FolderKind, claim_files, claimed, disown, kind_of


def contents(folder: Path) -> dict[str, bytes]:
    return {str(path.relative_to(folder)): path.read_bytes() for path in folder.rglob("*") if path.is_file()}


@pytest.fixture
def recording(drive, tmp_path, monkeypatch):
    """A copy, in which commands are given."""
    folder = shutil.copytree(drive, tmp_path / "recording")
    (folder / "study.yaml").write_text("sequences: [.]\nmodes: [vo]\nseeds: 1\n")
    (folder / "results.csv").write_text("mine")
    (folder / "plot_error.png").write_text("mine")
    (folder / "runs.txt").write_text("mine")
    monkeypatch.chdir(folder)
    return folder


@pytest.mark.parametrize(
    "command",
    [
        "run . --out .",
        "run . --out images",
        "compare . --modes vo --seeds 1 --out .",
        "compare . --modes vo --seeds 1 --out images",
        "study study.yaml --out .",
        "evaluate .",
        "plot .",
        "demo --out runs.txt",
        "run . --out runs.txt",
        "compare . --out runs.txt/x",
    ],
)
def test_no_command_writes_into_a_folder_that_is_not_ours(fvslam, recording, command):
    before = contents(recording)
    outcome = fvslam(*command.split())
    assert (outcome.code, outcome.out) == (1, "") and outcome.err.count("\n") == 1
    assert contents(recording) == before


def test_a_folder_is_ours_by_its_mark(tmp_path):
    with claimed(tmp_path / "a", FolderKind.STUDY):
        assert kind_of(tmp_path / "a") is FolderKind.STUDY
        (tmp_path / "a" / "results.csv").write_text("ours")
    with claimed(tmp_path / "a", FolderKind.STUDY):
        pass
    with (
        pytest.raises(ResultsError, match="is the folder of a study, not of a run"),
        claimed(tmp_path / "a", FolderKind.RUN),
    ):
        pass
    for content in (
        "",
        "{",
        "[]",
        '{"made_by": "somebody", "kind": "study"}',
        '{"made_by": "fvslam_graph", "kind": []}',
    ):
        (tmp_path / "a" / MARK).write_text(content)
        with (
            pytest.raises(ResultsError, match="holds files that are not of a study"),
            claimed(tmp_path / "a", FolderKind.STUDY),
        ):
            pass
    (tmp_path / "a" / "results.csv").unlink()
    with claimed(tmp_path / "a", FolderKind.STUDY):  # empty: who made it was killed before it had written the mark
        assert kind_of(tmp_path / "a") is FolderKind.STUDY


def test_the_information_of_a_run_is_a_mark_but_only_of_ours(tmp_path):
    (tmp_path / "run.json").write_text(json.dumps({"versions": {"fvslam_graph": "0.1.0"}}))
    assert kind_of(tmp_path) is FolderKind.RUN
    for content in ({"versions": {"other": "1"}}, {"versions": 3}, []):
        (tmp_path / "run.json").write_text(json.dumps(content))
        assert kind_of(tmp_path) is None


def test_a_folder_has_one_writer(tmp_path):
    script = (
        "import sys\nfrom pathlib import Path\nfrom fvslam_graph.runs.ownership import FolderKind, claimed\n"
        "with claimed(Path(sys.argv[1]), FolderKind.RUN):\n    print('held', flush=True)\n    sys.stdin.read()\n"
    )
    command = [sys.executable, "-c", script, str(tmp_path / "run")]
    with subprocess.Popen(command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True) as other:
        assert other.stdout.readline() == "held\n"
        with (
            pytest.raises(ResultsError, match="is in use by another process"),
            claimed(tmp_path / "run", FolderKind.RUN),
        ):
            pass
        other.kill()
    with claimed(tmp_path / "run", FolderKind.RUN), claimed(tmp_path / "run", FolderKind.RUN):  # the same thread, again
        pass


def test_figures_beside_other_files(tmp_path):
    (tmp_path / "notes.txt").write_text("mine")
    for _ in range(2):
        claim_files(tmp_path, ["a.png", "b.png"])
        (tmp_path / "a.png").write_text("ours")
    (tmp_path / MARK).unlink()
    with pytest.raises(ResultsError, match=r"a\.png exists and was not written by fvslam"):
        claim_files(tmp_path, ["b.png", "a.png"])


def test_what_somebody_else_has_put_there_keeps_a_folder(tmp_path):
    for name in ("empty", "full"):
        with claimed(tmp_path / name, FolderKind.IMAGES):
            pass
    (tmp_path / "full" / "notes.txt").write_text("mine")
    disown(tmp_path / "empty")
    disown(tmp_path / "full")
    assert not (tmp_path / "empty").exists()
    assert {path.name for path in (tmp_path / "full").iterdir()} == {"notes.txt", MARK, LOCK}


@pytest.mark.parametrize(
    ("one", "other"),
    [
        ("uav_1", "uav-1"),
        ("a b", "a-b"),
        ("飞行", "无人机"),
        ("x" * 300, "x" * 299),
        ("a", "a."),
        ("..", "."),
        ("", "-"),
    ],
)
def test_names_that_differ_are_other_files(one, other):
    assert file_name(one) != file_name(other)
    for name in (file_name(one), file_name(other)):
        assert name.isascii() and 0 < len(name) < 100 and Path(name).name == name and not name.startswith(".")


def test_a_plain_name_is_its_own():
    assert [file_name(name) for name in ("03", "MH_01_easy", "v1.2-b")] == ["03", "MH_01_easy", "v1.2-b"]


def test_one_line():
    assert one_line("a\nb\tc\r\n\x1b[31m\udcff") == "a b c  \\x1b[31m\\udcff"


def test_a_file_is_replaced_whole_or_not_at_all(tmp_path):
    path = tmp_path / "file"
    write_file(path, "first \udcff")
    assert path.read_bytes() == b"first \\udcff"
    with pytest.raises(KeyboardInterrupt), replacing(path) as temporary:
        temporary.write_text("half")
        raise KeyboardInterrupt
    assert [file.name for file in tmp_path.iterdir()] == ["file"] and path.read_text().startswith("first")
