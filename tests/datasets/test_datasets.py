"""Published recordings come whole or not at all, go on where they were stopped, and touch nothing of the user's."""

import hashlib
import io
import re
import shutil
import tarfile
import threading
import zipfile
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from pathlib import Path

import pytest

from fvslam_graph.core.errors import DatasetError, ResultsError
from fvslam_graph.datasets import registry
from fvslam_graph.datasets.download import CHECKSUMS, DOWNLOADS, get_dataset
from fvslam_graph.datasets.registry import Archive, Dataset, find_dataset, published
from fvslam_graph.datasets.unpack import unpack
from fvslam_graph.sequences.open import open_sequence


class Server(ThreadingHTTPServer):
    """Serves `files`; a part of one where `ranges`, and no more than `limit` bytes of one before it hangs up."""

    files: dict[str, bytes]
    ranges = True
    limit: int | None = None
    asked: list[str | None]


class Handler(BaseHTTPRequestHandler):
    server: Server

    def do_GET(self):
        wanted = self.headers.get("Range")
        self.server.asked.append(wanted)
        if (content := self.server.files.get(self.path)) is None:
            self.send_error(404)
            return
        etag = f'"{hashlib.sha256(content).hexdigest()}"'
        partly = wanted and self.server.ranges and self.headers.get("If-Range", etag) == etag
        begin = int(re.fullmatch(r"bytes=(\d+)-", wanted)[1]) if partly else 0
        if begin and begin >= len(content):
            self.send_error(416)
            return
        self.send_response(206 if begin else 200)
        self.send_header("ETag", etag)
        self.send_header("Content-Length", str(len(content) - begin))
        self.end_headers()
        self.wfile.write(content[begin : None if self.server.limit is None else begin + self.server.limit])

    def log_message(self, *_):
        pass


@pytest.fixture
def server():
    with Server(("127.0.0.1", 0), Handler) as server:
        server.files, server.asked = {}, []
        thread = threading.Thread(target=server.serve_forever, kwargs={"poll_interval": 0.01})
        thread.start()
        yield server
        server.shutdown()
        thread.join()


@pytest.fixture
def archive(drive, tmp_path):
    return lambda kind: Path(shutil.make_archive(tmp_path / "packed", kind, drive.parent, drive.name)).read_bytes()


def dataset(server, *names, sha256=None, open="drive"):
    archives = [
        Archive(url=f"http://127.0.0.1:{server.server_port}/{name}", gigabytes=0.1, sha256=sha256) for name in names
    ]
    return Dataset(title="A drive", page="https://example.org", licence="CC0", open=open, archives=archives)


@pytest.mark.parametrize(("name", "kind"), [("drive.zip", "zip"), ("drive.tgz", "gztar"), ("drive.tar", "tar")])
def test_it_is_opened(server, archive, tmp_path, name, kind):
    server.files[f"/{name}"] = archive(kind)
    path = get_dataset(dataset(server, name), tmp_path / "data" / "drive")
    assert len(open_sequence(path)) == 12
    assert {file.name for file in path.parent.iterdir() if not file.name.startswith(".")} == {"drive", CHECKSUMS}
    get_dataset(dataset(server, name), tmp_path / "data" / "drive")
    assert server.asked == [None]  # the second time, nothing


@pytest.mark.parametrize("ranges", [True, False])
def test_an_interrupted_download_goes_on(server, archive, tmp_path, ranges):
    """Where the server cannot send a part, from the beginning."""
    content = server.files["/drive.zip"] = archive("zip")
    server.ranges, server.limit = ranges, len(content) // 3
    known = dataset(server, "drive.zip", sha256=hashlib.sha256(content).hexdigest())
    with pytest.raises(DatasetError, match=r"the connection fails .*; the same command goes on from there"):
        get_dataset(known, tmp_path / "data")
    part = tmp_path / "data" / DOWNLOADS / "drive.zip.part"
    come = part.stat().st_size
    assert 0 < come <= server.limit and part.read_bytes() == content[:come]
    assert not (tmp_path / "data" / "drive").exists()
    server.limit = None
    assert len(open_sequence(get_dataset(known, tmp_path / "data"))) == 12
    assert server.asked == [None, f"bytes={come}-"]


def test_another_file_by_now(server, archive, tmp_path):
    """Nothing is put together of two files, also where no checksum tells and the archive has none either."""
    content = server.files["/drive.tar"] = archive("tar")
    server.limit = len(content) // 3
    with pytest.raises(DatasetError):
        get_dataset(dataset(server, "drive.tar"), tmp_path / "data")
    server.limit, server.files["/drive.tar"] = None, content.replace(b"image_width: 320", b"image_width: 321")
    path = get_dataset(dataset(server, "drive.tar"), tmp_path / "data")
    assert "image_width: 321" in (path / "camera.yaml").read_text()
    assert not list((path.parent / DOWNLOADS).iterdir())


def test_all_had_come_when_it_was_stopped(server, archive, tmp_path):
    content = server.files["/drive.zip"] = archive("zip")
    (tmp_path / "data").mkdir()
    server.limit = 0
    with pytest.raises(DatasetError):
        get_dataset(dataset(server, "drive.zip"), tmp_path / "data")
    (tmp_path / "data" / DOWNLOADS / "drive.zip.part").write_bytes(content)
    assert len(open_sequence(get_dataset(dataset(server, "drive.zip"), tmp_path / "data"))) == 12
    assert server.asked[1:] == [f"bytes={len(content)}-"]


class Interrupting:
    """A bar at which Ctrl-C is hit after the first piece."""

    total = 0

    def update(self, _):
        raise KeyboardInterrupt


def test_ctrl_c(server, archive, tmp_path, monkeypatch):
    """While it is downloaded, what has come is kept; while it is unpacked, all of it."""
    server.files["/drive.zip"] = archive("zip")
    known = dataset(server, "drive.zip")
    with pytest.raises(KeyboardInterrupt):
        get_dataset(known, tmp_path / "data", Interrupting())
    come = (tmp_path / "data" / DOWNLOADS / "drive.zip.part").stat().st_size
    with monkeypatch.context() as patched, pytest.raises(KeyboardInterrupt):
        patched.setattr(zipfile.ZipFile, "extractall", Interrupting().update)
        get_dataset(known, tmp_path / "data")
    assert not (tmp_path / "data" / "drive").exists()
    assert len(open_sequence(get_dataset(known, tmp_path / "data"))) == 12
    assert come > 0 and server.asked == [None, f"bytes={come}-"]


def test_a_wrong_checksum(server, archive, tmp_path):
    content = server.files["/drive.zip"] = archive("zip")
    out = tmp_path / "data"
    with pytest.raises(DatasetError, match=r"its SHA-256 is not 0{64}; it is not unpacked"):
        get_dataset(dataset(server, "drive.zip", sha256="0" * 64), out)
    assert not (out / "drive").exists() and not list((out / DOWNLOADS).iterdir())
    get_dataset(dataset(server, "drive.zip"), out)  # without one: that of this download holds from now on
    (out / "drive" / "mine.txt").write_text("mine")
    shutil.rmtree(out / "drive" / "images")
    (out / "drive").rename(out / "elsewhere")
    server.files["/drive.zip"] = content + b" "
    with pytest.raises(DatasetError, match=f"its SHA-256 is not {hashlib.sha256(content).hexdigest()}"):
        get_dataset(dataset(server, "drive.zip"), out)
    assert (out / "elsewhere" / "mine.txt").read_text() == "mine"


def test_files_of_the_user_stay(server, archive, tmp_path):
    server.files["/drive.zip"] = archive("zip")
    out = tmp_path / "data"
    out.mkdir()
    (out / "mine.txt").write_text("mine")
    with pytest.raises(ResultsError, match="holds files that are not of a published data set"):
        get_dataset(dataset(server, "drive.zip"), out)
    (out / "mine.txt").unlink()
    get_dataset(dataset(server, "drive.zip"), out)
    (out / "drive" / "camera.yaml").write_text("mine")
    get_dataset(dataset(server, "drive.zip", "drive.zip"), out)
    (out / CHECKSUMS).unlink()
    get_dataset(dataset(server, "drive.zip"), out)
    assert (out / "drive" / "camera.yaml").read_text() == "mine" and len(server.asked) == 2


def test_two_archives_of_one_folder(server, tmp_path):
    for name in ("calib", "images"):
        content = io.BytesIO()
        with zipfile.ZipFile(content, "w") as file:
            file.writestr(f"date/{name}/{name}.txt", name)
        server.files[f"/{name}.zip"] = content.getvalue()
    path = get_dataset(dataset(server, "calib.zip", "images.zip", open="date/images"), tmp_path / "data")
    assert sorted(file.name for file in path.parent.rglob("*.txt")) == ["calib.txt", "images.txt"]


@pytest.mark.parametrize(
    ("files", "complaint"),
    [
        ({}, "the server answers 404"),
        ({"/drive.zip": b"<html>a page</html>"}, "drive.zip is damaged"),
        ({"/drive.zip": b"PK\x05\x06" + 18 * b"\0"}, "do not hold drive"),
    ],
)
def test_what_is_no_archive(server, tmp_path, files, complaint):
    server.files = files
    with pytest.raises(DatasetError, match=complaint):
        get_dataset(dataset(server, "drive.zip"), tmp_path / "data")
    assert not list((tmp_path / "data" / DOWNLOADS).glob("*.zip"))


def test_a_server_that_is_not_there(server, tmp_path):
    gone = dataset(server, "drive.zip")
    server.server_close()
    with pytest.raises(DatasetError, match="cannot be downloaded: the connection fails"):
        get_dataset(gone, tmp_path / "data")


@pytest.mark.parametrize("name", ["../outside", "/tmp/outside", "..\\outside", "C:\\outside", "a/../../outside"])
def test_no_file_lands_elsewhere(tmp_path, name):
    folder = tmp_path / "data"
    folder.mkdir()
    with zipfile.ZipFile(tmp_path / "a.zip", "w") as file:
        file.writestr("inside", "")
        file.writestr(zipfile.ZipInfo(name), "")
    packed = [tmp_path / "a.zip"]
    if "\\" not in name:
        with tarfile.open(tmp_path / "a.tar", "w") as file:
            link = tarfile.TarInfo("link")
            link.type, link.linkname = tarfile.SYMTYPE, name
            file.addfile(link)
        packed.append(tmp_path / "a.tar")
    for archive in packed:
        with pytest.raises(DatasetError, match="has a file outside of its folder"):
            unpack(archive, folder)
    assert list(folder.iterdir()) == [] and not (tmp_path / "outside").exists()


def test_a_damaged_archive_leaves_nothing(archive, tmp_path):
    for kind in ("zip", "gztar"):
        content = bytearray(archive(kind))
        content[len(content) // 2] ^= 0xFF
        (tmp_path / "damaged").write_bytes(content)
        folder = tmp_path / kind
        folder.mkdir()
        with pytest.raises(DatasetError, match="damaged"):
            unpack(tmp_path / "damaged", folder)
        assert list(folder.iterdir()) == []


def test_what_is_published():
    for name, known in published().items():
        assert re.fullmatch(r"[a-z0-9-]+", name) and known.licence and known.page.startswith("https://")
        assert all(archive.url.startswith("https://") and archive.name for archive in known.archives)
    with pytest.raises(DatasetError, match="no data set is called 'kitti'; there are kitti-raw-0001, "):
        find_dataset("kitti")


def test_on_the_command_line(server, archive, tmp_path, monkeypatch, fvslam):
    monkeypatch.chdir(tmp_path)
    server.files["/drive.zip"] = archive("zip")
    monkeypatch.setattr(registry, "published", lambda: {"drive": dataset(server, "drive.zip")})
    ended = fvslam("data", "get", "drive")
    assert ended.code == 0 and "licence: CC0 (https://example.org)" in ended.out
    assert f"that of this download is in data/drive/{CHECKSUMS}" in ended.out
    assert ended.out.endswith("next: fvslam info data/drive/drive\n")
    assert fvslam("data", "get", "nothing").err == "fvslam: no data set is called 'nothing'; there are drive\n"
    monkeypatch.undo()
    listed = fvslam("data", "list")
    assert listed.code == 0 and "kitti-raw-0001" in listed.out and "CC BY-NC-SA 3.0" in listed.out
    by_hand = fvslam("data", "get", "euroc-v1-01", "--out", tmp_path / "euroc")
    assert by_hand.code == 1 and "given out through its page alone" in by_hand.err
    assert not (tmp_path / "euroc").exists()
