"""Files are looked at before they are read, and written whole, also where something else is there."""

from __future__ import annotations

import io
import os
import stat
import threading
import zipfile
from pathlib import Path

import numpy as np
import pytest

from offroad_env.errors import DataError
from offroad_env.world.files import read_arrays, read_file, read_json, write_file
from offroad_env.world.yaml_text import parse_yaml, shown


def test_a_pipe_that_nobody_writes_to_is_refused_at_once(tmp_path):
    os.mkfifo(tmp_path / "pipe")
    with pytest.raises(DataError, match="pipe: is a device, pipe or socket"):
        read_file(tmp_path / "pipe", most=100)


@pytest.mark.parametrize("device", ["/dev/zero", "/dev/null", "/dev/random"])
def test_a_device_is_no_file(device):
    with pytest.raises(DataError, match="is a device"):
        read_file(device, most=100)


def test_a_file_that_is_too_long_is_refused_before_it_is_read(tmp_path):
    with (tmp_path / "sparse").open("wb") as file:
        file.truncate(10**12)
    with pytest.raises(DataError, match=r"has 1e\+06 MB; at most 1 MB"):
        read_file(tmp_path / "sparse", most=1_000_000)


@pytest.mark.parametrize(
    ("content", "words"),
    [
        ("[" * 100_000, "nested too deeply"),
        ("[]", "must hold a JSON object, holds a list"),
        ("{", "is not JSON"),
        ('{"a": ' + "1" * 6000 + "}", "is not JSON"),
        ("\udcff", "is not UTF-8"),
    ],
)
def test_what_is_no_object_of_json_is_named(tmp_path, content, words):
    (tmp_path / "x.json").write_bytes(content.encode("utf-8", "surrogateescape"))
    with pytest.raises(DataError, match=words):
        read_json(tmp_path / "x.json")


def test_arrays_come_back_and_objects_do_not(tmp_path):
    np.savez(tmp_path / "a.npz", x=np.arange(6.0).reshape(2, 3), n=np.array(3))
    found = read_arrays(tmp_path / "a.npz")
    assert np.array_equal(found["x"], np.arange(6.0).reshape(2, 3))
    assert found["n"] == 3
    np.savez(tmp_path / "b.npz", x=np.array([{}], dtype=object))
    with pytest.raises(DataError, match=r"is no \.npz file of numbers"):
        read_arrays(tmp_path / "b.npz")
    np.savez_compressed(tmp_path / "c.npz", x=np.zeros(100_000))
    with pytest.raises(DataError, match="its arrays would take more than"):
        read_arrays(tmp_path / "c.npz", most=10_000)


@pytest.mark.parametrize("change", [lambda array: array + b"more", lambda array: array[:-8]])
def test_an_array_of_another_length_than_its_head_states_is_refused(change, tmp_path):
    sink = io.BytesIO()
    np.save(sink, np.arange(6.0))
    with zipfile.ZipFile(tmp_path / "a.npz", "w") as archive:
        archive.writestr("x.npy", change(sink.getvalue()))
    with pytest.raises(DataError, match="another number of values than it states"):
        read_arrays(tmp_path / "a.npz")


def test_a_device_is_written_to_and_stays_a_device():
    device = Path("/dev/null")
    before = device.stat()
    write_file(device, b"x")
    after = device.stat()
    assert stat.S_ISCHR(after.st_mode)
    assert (before.st_ino, before.st_rdev) == (after.st_ino, after.st_rdev)


def test_a_pipe_is_written_to(tmp_path):
    pipe, heard = tmp_path / "pipe", []
    os.mkfifo(pipe)
    reader = threading.Thread(target=lambda: heard.append(pipe.read_bytes()))
    reader.start()
    write_file(pipe, b"numbers")
    reader.join(10.0)
    assert heard == [b"numbers"]
    assert stat.S_ISFIFO(pipe.stat().st_mode)


def test_a_link_stays_a_link_and_its_target_is_replaced(tmp_path):
    (tmp_path / "there").mkdir()
    target, link = tmp_path / "there" / "x.json", tmp_path / "x.json"
    target.write_text("old")
    link.symlink_to(target)
    write_file(link, b"new")
    assert link.is_symlink()
    assert target.read_text() == "new"
    assert [path.name for path in target.parent.iterdir()] == ["x.json"]


def test_a_full_disk_leaves_the_old_file_and_nothing_beside_it(tmp_path, monkeypatch):
    path = tmp_path / "x.json"
    path.write_text("old")

    class Full(io.BytesIO):
        def write(self, _):
            raise OSError(28, "No space left on device")

    monkeypatch.setattr(os, "fdopen", lambda handle, _: os.close(handle) or Full())
    with pytest.raises(OSError, match="No space left"):
        write_file(path, b"new")
    assert path.read_text() == "old"
    assert list(tmp_path.iterdir()) == [path]


def test_a_file_may_be_read_by_those_who_might_before(tmp_path):
    path = tmp_path / "x.json"
    before = os.umask(0o027)
    try:
        write_file(path, b"first")
        assert stat.S_IMODE(path.stat().st_mode) == 0o640
        path.chmod(0o600)
        write_file(path, b"second")
        assert stat.S_IMODE(path.stat().st_mode) == 0o600
        write_file(tmp_path / "secret", b"", private=True)
        assert stat.S_IMODE((tmp_path / "secret").stat().st_mode) == 0o600
    finally:
        os.umask(before)


def test_aliases_count_as_often_as_they_repeat():
    lines = ["a0: &a0 [x, x, x, x, x, x, x, x, x, x]"]
    lines += [f"a{i}: &a{i} [{', '.join([f'*a{i - 1}'] * 10)}]" for i in range(1, 4)]
    few, _ = parse_yaml("\n".join(lines[:3]), "x", about="a soil")
    assert len(few["a2"]) == 10
    with pytest.raises(DataError, match=r"line 4: YAML syntax: more than 10000 values"):
        parse_yaml("\n".join(lines), "x", about="a soil")
    with pytest.raises(DataError, match="an alias inside of what it names"):
        parse_yaml("a: &a [*a]", "x", about="a soil")


def test_quoting_a_value_takes_no_longer_than_its_beginning():
    inner = ["x"] * 10
    for _ in range(40):
        inner = [inner] * 10  # 10^41 entries, were they written out
    assert len(shown(inner)) <= 40
    assert shown(16**5000) == "a number of 20001 bits"
    assert shown("\x1b[2J") == "'\\x1b[2J'"
