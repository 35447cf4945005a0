"""The 1:10 car's drives: their published tables join to one, and only the registered drives are taken."""

from __future__ import annotations

import threading
from dataclasses import replace
from http.server import BaseHTTPRequestHandler, HTTPServer

import numpy as np
import pytest

from helpers import measured_data
from offroad_env.errors import DataError, InvalidParameter
from offroad_env.world import datasets
from offroad_env.world.datasets import DATASETS, UNPUBLISHED, fetch
from offroad_env.world.published_drives import DRIVES, TABLES, is_drive, join_drive


def published_tables(shift: float = 0.0) -> dict[str, str]:
    """Tables of a made-up drive as the authors write them: an index, seconds, nanoseconds."""

    def table(heading: str, begin: float, step: float, count: int, row) -> str:
        stamps = 1_650_775_094.0 + begin + step * np.arange(count)
        lines = [f",s,ns,{heading}"]
        for t in stamps:
            values = ",".join(repr(float(value)) for value in row(t - 1_650_775_094.0))
            lines.append(f"0,{int(t)},{round(1e9 * (t - int(t)))},{values}")
        return "\n".join(lines) + "\n"

    return {
        "command": table("V,delta", 0.0, 0.03, 40, lambda t: (1.0 + t, 0.1 * t)),
        "imu": table("phi_r,ax,ay,az,wx,wy,wz", 0.0, 0.02, 60, lambda t: (0, 1, 2, 3, 4, 5, 6 + t + shift)),
        "odometry": table("vx,vy", 0.01, 0.02, 60, lambda t: (2.0 + t, 0)),
        "filter": table("vx,vy", 0.1, 0.02, 60, lambda t: (3.0 + t, 0)),
        "pose": table("x,y,q.z,q.w", 0.0, 0.05, 20, lambda t: (t, 2 * t, np.sin(t), np.cos(t))),
    }


def columns(text: str) -> dict[str, np.ndarray]:
    head, *rows = text.splitlines()
    return dict(zip(head.split(","), np.array([row.split(",") for row in rows], float).T, strict=True))


def test_a_row_for_every_sample_of_the_imu_while_all_tables_have_samples():
    joined = columns(join_drive(published_tables()))
    t = joined["t_s"] + 0.1  # the particle filter comes last
    assert t[-1] <= 0.95 < t[-1] + 0.02  # and its pose ends first
    assert np.allclose(joined["pf_x_m"], t, atol=1e-5)  # straight between samples
    assert np.allclose(joined["pf_yaw_rad"], 2.0 * t, atol=1e-4)
    assert np.allclose(joined["gyro_z_rad_s"], 6.0 + t, atol=1e-5)
    late = t - (joined["cmd_speed_m_s"] - 1.0)  # held from the command before
    assert late.min() > -1e-5
    assert late.max() < 0.03 + 1e-5


@pytest.mark.parametrize("name", DRIVES)
def test_the_drives_at_hand_are_the_registered_ones(name):
    text = (measured_data("f1tenth_indoor") / f"{name}.csv").read_text()
    assert is_drive(name, text)
    assert not is_drive(name, text.replace("0.297751", "0.397751"))
    assert not is_drive(name, text.rsplit("\n", 3)[0])


@pytest.mark.parametrize(
    ("name", "change"), [("imu", lambda text: text.replace("wz", "w")), ("pose", lambda text: "nothing")]
)
def test_a_table_that_is_not_the_published_one_is_named(name, change):
    tables = published_tables()
    tables[name] = change(tables[name])
    with pytest.raises(DataError, match=TABLES[name]):
        join_drive(tables)


@pytest.fixture
def publisher():
    """Serves the tables of made-up drives below /DS1 ... /DS3; the second time with another number."""
    shift = [0.0]

    class Handler(BaseHTTPRequestHandler):
        def do_GET(self):
            name = self.path.rsplit("/", 1)[-1]
            key = next(key for key, file in TABLES.items() if file == name)
            body = published_tables(shift[0])[key].encode()
            self.send_response(200)
            self.send_header("Content-Length", str(len(body)))
            self.end_headers()
            self.wfile.write(body)

        def log_message(self, *_):
            """Keep the test's output clean."""

    server = HTTPServer(("127.0.0.1", 0), Handler)
    thread = threading.Thread(target=server.serve_forever, kwargs={"poll_interval": 0.01})
    thread.start()
    yield f"http://127.0.0.1:{server.server_port}/", shift
    server.shutdown()
    thread.join()
    server.server_close()


def test_the_tables_are_downloaded_joined_and_checked(publisher, tmp_path, monkeypatch):
    address, shift = publisher
    monkeypatch.setenv("NO_PROXY", "127.0.0.1")
    joined = join_drive(published_tables())
    means = tuple(np.abs(values).mean() for values in columns(joined).values())
    made_up = {name: (len(joined.splitlines()) - 1, means) for name in DRIVES}
    monkeypatch.setattr("offroad_env.world.published_drives.DRIVES", made_up)
    registry = {"f1tenth_indoor": replace(DATASETS["f1tenth_indoor"], url=address)}
    path = fetch("f1tenth_indoor", registry=registry, folder=tmp_path)
    assert path.read_text() == joined
    assert sorted(file.name for file in path.parent.iterdir()) == [
        "CITATION.txt", "DS1.csv", "DS2.csv", "DS3.csv", "LICENSE.txt",
    ]  # fmt: skip
    shift[0] = 1.0
    with pytest.raises(DataError, match="does not join"):
        fetch("f1tenth_indoor", registry=registry, folder=tmp_path / "other")
    assert not (tmp_path / "other").exists()


def test_what_nobody_publishes_is_listed_and_said_so():
    assert {"chrono_scm", "scm_drives"} <= set(UNPUBLISHED)
    with pytest.raises(InvalidParameter, match="OFFROAD_DATA"):
        datasets.fetch("chrono_scm")
