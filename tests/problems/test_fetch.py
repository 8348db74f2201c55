"""Downloads against a server on this machine, with every fault a server has."""

import hashlib
import threading
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from pathlib import Path
from urllib.parse import unquote

import pytest

from problems import fetch as module
from problems.fetch import BACK_LIFTING, GAIT10DOF18MUSC, WALKING3D, DataSet, fetch
from scso_nlp.exceptions import DataError

CONTENT = {"model.osim": b"<OpenSimDocument/>", "trial one/ik.sto": b"endheader\ntime a\n0 1\n" * 500}


def digest(content):
    return hashlib.sha256(content).hexdigest()


DATA = DataSet(
    name="lift",
    repository="someone/model",
    commit="0123456789abcdef0123456789abcdef01234567",
    folder="data",
    license="Apache-2.0",
    files={"model.osim": digest(CONTENT["model.osim"]), "trial/ik.sto": digest(CONTENT["trial one/ik.sto"])},
    origins={"trial/ik.sto": "trial one/ik.sto"},
)


class Server:
    """Serves `files` by path; `faults` says what goes wrong with which."""

    def __init__(self):
        start = f"/{DATA.repository}/{DATA.commit}/{DATA.folder}/"
        self.files = {start + name: content for name, content in CONTENT.items()}
        self.faults, self.asked = {}, []
        server = self

        class Handler(BaseHTTPRequestHandler):
            def do_GET(self):
                path = unquote(self.path)
                name = path.rpartition("/")[2]
                server.asked.append(name)
                fault = server.faults.get(name)
                if fault == "missing" or path not in server.files:
                    self.send_error(404)
                    return
                content = b"something else" if fault == "changed" else server.files[path]
                self.send_response(200)
                self.send_header("Content-Length", str(len(content)))
                self.end_headers()
                self.wfile.write(content[: len(content) // 2] if fault == "cut" else content)
                self.close_connection = True

            def log_message(self, *_):
                pass

        self.http = ThreadingHTTPServer(("127.0.0.1", 0), Handler)
        self.url = f"http://127.0.0.1:{self.http.server_port}"
        self.thread = threading.Thread(target=self.http.serve_forever, args=(0.02,), daemon=True)
        self.thread.start()

    def stop(self):
        self.http.shutdown()
        self.http.server_close()
        self.thread.join()


@pytest.fixture
def server(monkeypatch):
    monkeypatch.delenv(module.LOCAL_COPY, raising=False)
    server = Server()
    yield server
    server.stop()


def test_files_are_fetched_once_and_found_in_the_cache_afterwards(server, tmp_path):
    folder = fetch(DATA, cache=tmp_path, base_url=server.url)
    assert folder == tmp_path / "lift"
    assert (folder / "model.osim").read_bytes() == CONTENT["model.osim"]
    assert (folder / "trial" / "ik.sto").read_bytes() == CONTENT["trial one/ik.sto"]
    assert sorted(server.asked) == ["ik.sto", "model.osim"]
    server.stop()
    assert fetch(DATA, cache=tmp_path, base_url=server.url) == folder


@pytest.mark.parametrize(
    ("fault", "message"),
    [
        ("missing", r"the server answered 404"),
        ("changed", r"its SHA-256 differs"),
        ("cut", r"could not be fetched from"),
    ],
)
def test_a_fault_of_the_server_is_named_and_leaves_no_broken_file(server, tmp_path, fault, message):
    server.faults["ik.sto"] = fault
    with pytest.raises(DataError, match=message) as caught:
        fetch(DATA, cache=tmp_path, base_url=server.url)
    assert "trial/ik.sto of the data set 'lift'" in str(caught.value)
    assert "set SCSO_DATA to the folder that holds it" in str(caught.value)
    assert not (tmp_path / "lift" / "trial" / "ik.sto").exists()
    assert [path.name for path in tmp_path.rglob("*") if path.is_file()] == ["model.osim"]
    # the next attempt gets what was missing, and only that
    server.faults.clear()
    server.asked.clear()
    fetch(DATA, cache=tmp_path, base_url=server.url)
    assert server.asked == ["ik.sto"]


def test_a_damaged_file_in_the_cache_is_fetched_again(server, tmp_path):
    folder = fetch(DATA, cache=tmp_path, base_url=server.url)
    (folder / "model.osim").write_bytes(b"damaged")
    server.asked.clear()
    fetch(DATA, cache=tmp_path, base_url=server.url)
    assert server.asked == ["model.osim"]
    assert (folder / "model.osim").read_bytes() == CONTENT["model.osim"]


def test_without_a_network_the_message_says_what_to_put_where(server, tmp_path):
    server.stop()
    with pytest.raises(DataError) as caught:
        fetch(DATA, cache=tmp_path, base_url=server.url)
    text = str(caught.value)
    for part in (
        "model.osim, trial/ik.sto",
        "github.com/someone/model at commit 0123456789ab",
        "folder 'data'",
    ):
        assert part in text


def test_a_local_copy_is_used_without_asking_anyone(server, tmp_path, monkeypatch):
    monkeypatch.setenv(module.LOCAL_COPY, str(tmp_path))
    folder = tmp_path / "lift"
    with pytest.raises(DataError, match=r"SCSO_DATA is set, but .*lift lacks model.osim, trial/ik.sto"):
        fetch(DATA, base_url=server.url)
    (folder / "trial").mkdir(parents=True)
    (folder / "model.osim").write_bytes(CONTENT["model.osim"])
    (folder / "trial" / "ik.sto").write_bytes(b"another trial")
    with pytest.raises(DataError, match=r"ik.sto is not the file the problem was made for \(SHA-256"):
        fetch(DATA, base_url=server.url)
    (folder / "trial" / "ik.sto").write_bytes(CONTENT["trial one/ik.sto"])
    assert fetch(DATA, base_url=server.url) == folder
    assert server.asked == []


@pytest.mark.parametrize("data", [GAIT10DOF18MUSC, WALKING3D, BACK_LIFTING], ids=lambda data: data.name)
def test_pinned_hashes_are_those_of_the_files_at_hand(data, shared_data, monkeypatch):
    monkeypatch.setenv(module.LOCAL_COPY, str(shared_data))
    assert fetch(data) == shared_data / data.name


@pytest.mark.parametrize("data", [GAIT10DOF18MUSC, WALKING3D, BACK_LIFTING], ids=lambda data: data.name)
def test_addresses_are_pinned_to_a_full_commit_and_carry_no_blanks(data):
    assert len(data.commit) == 40
    assert set(data.origins) <= set(data.files)
    for file in data.files:
        address = data.url(file)
        assert address.startswith(f"https://raw.githubusercontent.com/{data.repository}/{data.commit}/")
        assert " " not in address
        assert address.endswith(Path(file).name)
