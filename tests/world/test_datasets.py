"""Datasets: a good download is kept, anything else leaves one sentence and nothing behind."""

from __future__ import annotations

import hashlib
import socket
import threading
from dataclasses import replace
from http.server import BaseHTTPRequestHandler, HTTPServer

import pytest

from helpers import run_fresh
from offroad_env.errors import DataError, InvalidParameter
from offroad_env.world import datasets
from offroad_env.world.datasets import DATASETS, Dataset, describe, fetch, locate

CONTENT = b"slip,sinkage\n0.1,0.02\n" * 40


class _Publisher(BaseHTTPRequestHandler):
    """Serves /good, /damaged (right length, one byte wrong), /short (cut off), else 404."""

    requests: list[str]

    def do_GET(self):
        self.requests.append(self.path)
        if self.path == "/missing":
            self.send_error(404, "Not Found")
            return
        body = CONTENT if self.path != "/damaged" else b"X" + CONTENT[1:]
        if self.path == "/endless":
            body = CONTENT + bytes(30_000_000)
        self.send_response(200)
        self.send_header("Content-Length", str(len(body)))
        self.end_headers()
        self.wfile.write(body if self.path != "/short" else body[:100])

    def log_message(self, *_):
        """Keep the test's output clean."""


@pytest.fixture
def publisher():
    handler = type("Publisher", (_Publisher,), {"requests": []})
    server = HTTPServer(("127.0.0.1", 0), handler)
    thread = threading.Thread(target=server.serve_forever, kwargs={"poll_interval": 0.01})
    thread.start()
    yield f"http://127.0.0.1:{server.server_port}", handler.requests
    server.shutdown()
    thread.join()
    server.server_close()


@pytest.fixture(autouse=True)
def own_cache(request, tmp_path, monkeypatch):
    monkeypatch.setenv("OFFROAD_CACHE", str(tmp_path / "cache"))
    if "offroad_data" not in request.fixturenames:  # which looks for the real data where this points
        monkeypatch.delenv("OFFROAD_DATA", raising=False)
    # A proxy of the machine must not stand between the test and its local server.
    monkeypatch.setenv("NO_PROXY", "127.0.0.1")


def _registry(url: str) -> dict[str, Dataset]:
    dataset = Dataset(
        name="tiny",
        title="a tiny table",
        url=url,
        file_name="tiny.csv",
        sha256=hashlib.sha256(CONTENT).hexdigest(),
        size=len(CONTENT),
        licence="MIT",
        licence_text="Copyright 2020 Nobody\n\ndo as you like",
        citation="Nobody, 2020",
    )
    return {"tiny": dataset}


def _files(folder):
    return sorted(p.name for p in folder.rglob("*") if p.is_file())


def test_good_file_is_cached_with_its_licence_and_not_downloaded_twice(publisher):
    address, requests = publisher
    registry = _registry(f"{address}/good")
    path = fetch("tiny", registry=registry)
    assert path.read_bytes() == CONTENT
    assert path.is_relative_to(datasets.cache_folder())
    assert "Nobody" in (path.parent / "LICENSE.txt").read_text()
    assert "Nobody, 2020" in (path.parent / "CITATION.txt").read_text()
    assert _files(path.parent) == ["CITATION.txt", "LICENSE.txt", "tiny.csv"]
    assert fetch("tiny", registry=registry) == path
    assert requests == ["/good"]
    assert locate("tiny", registry=registry) == path


def test_damaged_cached_file_is_replaced(publisher):
    registry = _registry(f"{publisher[0]}/good")
    path = fetch("tiny", registry=registry)
    path.write_bytes(b"rubbish")
    with pytest.raises(DataError, match=r"not the published tiny\.csv \(7 bytes"):
        locate("tiny", registry=registry)
    assert fetch("tiny", registry=registry).read_bytes() == CONTENT


def test_wrong_content_is_refused_and_leaves_nothing(publisher, tmp_path):
    with pytest.raises(DataError, match=r"SHA-256 differs.*nothing was kept") as caught:
        fetch("tiny", registry=_registry(f"{publisher[0]}/damaged"))
    assert "\n" not in str(caught.value)
    assert _files(tmp_path) == []
    assert not (datasets.cache_folder() / "tiny").exists()


def test_download_cut_off_is_refused_and_leaves_nothing(publisher, tmp_path):
    with pytest.raises(DataError, match="tiny"):
        fetch("tiny", registry=_registry(f"{publisher[0]}/short"))
    assert _files(tmp_path) == []


def test_absent_file_is_told_with_the_answer(publisher, tmp_path):
    with pytest.raises(DataError, match="answered 404"):
        fetch("tiny", registry=_registry(f"{publisher[0]}/missing"))
    assert _files(tmp_path) == []


def test_server_down_is_one_clear_sentence(tmp_path):
    with socket.socket() as free:
        free.bind(("127.0.0.1", 0))
        port = free.getsockname()[1]
    with pytest.raises(DataError, match=r"no connection to 127\.0\.0\.1.*OFFROAD_DATA") as caught:
        fetch("tiny", registry=_registry(f"http://127.0.0.1:{port}/good"))
    assert "\n" not in str(caught.value)
    assert _files(tmp_path) == []


def test_unwritable_cache_is_one_clear_sentence(publisher, tmp_path):
    (tmp_path / "cache").write_text("a file where a folder should be")
    with pytest.raises(DataError, match="could not be stored"):
        fetch("tiny", registry=_registry(f"{publisher[0]}/good"))


def test_progress_reports_every_byte(publisher):
    class Bar:
        total = 0
        seen = 0
        closed = False

        def update(self, n):
            self.seen += n

        def reset(self):
            self.seen = 0

        def close(self):
            self.closed = True

    bar = Bar()
    fetch("tiny", registry=_registry(f"{publisher[0]}/good"), progress=bar)
    assert (bar.total, bar.seen, bar.closed) == (len(CONTENT), len(CONTENT), True)


def test_a_download_that_is_longer_than_registered_stops_there(publisher, tmp_path, monkeypatch):
    received = []
    monkeypatch.setattr(datasets._Download, "__init__", counting(received, datasets._Download.__init__))
    with pytest.raises(DataError, match="is not the published"):
        fetch("tiny", registry=_registry(f"{publisher[0]}/endless"), folder=tmp_path / "cache")
    assert sum(received) < 100_000
    assert not list((tmp_path / "cache").rglob("*.csv"))


def counting(received, before):
    """A download that notes what it takes, in place of a bar on the terminal."""

    class Bar:
        total = 0

        def update(self, n):
            received.append(n)

        def reset(self):
            pass

        def close(self):
            pass

    def made(self, most, _):
        before(self, most, Bar())

    return made


def test_terminal_bar_ends_even_when_the_download_fails(publisher, capsys):
    fetch("tiny", registry=_registry(f"{publisher[0]}/good"), progress=True)
    with pytest.raises(DataError):
        fetch(
            "tiny",
            registry=_registry(f"{publisher[0]}/damaged"),
            progress=True,
            folder=datasets.cache_folder() / "b",
        )
    assert "tiny.csv" in capsys.readouterr().out


def test_locate_prefers_the_users_folder_and_never_downloads(publisher, tmp_path, monkeypatch):
    address, requests = publisher
    registry = _registry(f"{address}/good")
    with pytest.raises(DataError, match="offroad data get tiny"):
        locate("tiny", registry=registry)
    own = tmp_path / "own" / "tiny" / "original" / "tiny.csv"
    own.parent.mkdir(parents=True)
    own.write_bytes(CONTENT)
    monkeypatch.setenv("OFFROAD_DATA", str(tmp_path / "own"))
    assert locate("tiny", registry=registry) == own
    assert requests == []
    fetch("tiny", registry=registry)
    assert locate("tiny", registry=registry) == own
    own.write_bytes(b"another version")
    with pytest.raises(DataError, match="not the published"):
        locate("tiny", registry=registry)


def test_unknown_dataset_names_the_known_ones():
    for ask in (fetch, locate, describe):
        with pytest.raises(InvalidParameter, match="did you mean 'cmu_single_wheel'"):
            ask("cmu_wheel")


def test_registered_dataset_is_pinned_and_shows_its_licence():
    dataset = DATASETS["cmu_single_wheel"]
    commit = dataset.url.split("/")[5]
    assert dataset.url.startswith("https://raw.githubusercontent.com/robomechanics/3d-terramechanics/")
    assert len(commit) == 40
    assert len(dataset.sha256) == 64
    text = describe("cmu_single_wheel")
    for needed in (
        "Catherine Pavlov, Carnegie Mellon University",
        "Permission is hereby granted",
        dataset.url,
    ):
        assert needed in text


def test_publishers_own_file_is_the_registered_one(offroad_data, monkeypatch):
    folder = offroad_data("cmu_single_wheel")
    monkeypatch.setenv("OFFROAD_DATA", str(folder.parent))
    path = locate("cmu_single_wheel")
    assert path.stat().st_size == DATASETS["cmu_single_wheel"].size
    changed = {"cmu_single_wheel": replace(DATASETS["cmu_single_wheel"], sha256="0" * 64)}
    with pytest.raises(DataError, match="not the published"):
        locate("cmu_single_wheel", registry=changed)


def test_importing_datasets_imports_neither_pooch_nor_requests():
    code = "import sys, offroad_env.world.datasets; print({'pooch', 'requests', 'rich'} & set(sys.modules))"
    assert run_fresh(code).strip() == "set()"
