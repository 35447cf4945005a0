"""Damaged and hostile files: seeded mutations of good ones, and some that were thought out.

Each belongs to a kind, and each kind has a reader. A reader may accept a file or refuse it with an
`OffroadError`; nothing else may happen, and it may take neither long nor much room.
"""

from __future__ import annotations

import io
import json
import os
import zipfile
from collections.abc import Callable, Iterator
from functools import cache
from pathlib import Path
from typing import NamedTuple

import numpy as np
import yaml
from bad_logs import DESCRIPTION, good_rows, rig, text_of, write

from agents.learning.checkpoint import CHECKPOINT, read_checkpoint
from agents.learning.policies import learned_folder, load_policy
from estimators.logs import quality, read_log, write_log
from estimators.logs.checking.check import check_log
from offroad_env.effects import read_extension
from offroad_env.environment.scenario_descriptions import find_scenario
from offroad_env.environment.scenarios import SCENARIOS
from offroad_env.world.descriptions import read_soil, read_vehicle

__all__ = ["READERS", "File", "crafted", "mutations"]


class File(NamedTuple):
    """A hostile file, ready to be written."""

    kind: str
    name: str
    make: Callable[[Path], Path]  #: writes it into a folder and returns what its reader takes


# ------------------------------------------------------------------ readers


def _read_log(path: Path) -> None:
    quality(read_log(path))


READERS: dict[str, Callable[[Path], object]] = {
    "csv": _read_log,
    "check": check_log,
    "description": _read_log,
    "parquet": _read_log,
    "bag": _read_log,
    "soil": lambda path: read_soil(str(path)),
    "vehicle": lambda path: read_vehicle(str(path)),
    "scenario": lambda path: find_scenario(str(path)),
    "extension": read_extension,
    "policy": load_policy,
    "weights": load_policy,
    "checkpoint": lambda path: read_checkpoint(path, "c0ffee", SCENARIOS["speed"]),
}

# ------------------------------------------------------------------ good files


def _log_files(ending: str) -> dict[str, bytes]:
    import tempfile

    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        write(folder, text_of(good_rows()))
        if ending == ".csv":
            paths = [folder / "run.csv", folder / "run.yaml"]
        else:
            path = write_log(folder / f"other{ending}", read_log(folder / "run.csv"))
            paths = [path, path.with_suffix(".yaml")]
        return {f"run{path.suffix}": path.read_bytes() for path in paths}


EXTENSION = {
    "format": "offroad-extension-2",
    "model": "full",
    "effects": [
        {"id": "payload", "parameters": {"share": 0.2}},
        {"id": "n_step", "parameters": {"step": 0.1, "place": 3.0, "direction": 0.1}},
    ],
}
SOIL = {"soil": {"base": "clay", "n": 0.7, "c": 5000.0, "phi": 0.3}}
VEHICLE = {"vehicle": {"base": "mrzr", "m": 1450.0, "h_cg": 0.6}}
SCENARIO = {"scenario": {"base": "speed", "corridor": 2.5, "n_range": [0.5, 0.9]}}


@cache
def _good(kind: str) -> tuple[dict[str, bytes], str, str]:
    """(Files of a good example, which of them is mutated, what the reader takes; "" for the folder)."""
    if kind in ("csv", "check"):
        return _log_files(".csv"), "run.csv", "run.csv"
    if kind == "description":
        return _log_files(".csv"), "run.yaml", "run.csv"
    if kind == "parquet":
        return _log_files(".parquet"), "run.parquet", "run.parquet"
    if kind == "bag":
        return _log_files(".mcap"), "run.mcap", "run.mcap"
    if kind == "extension":
        return {"extended.json": json.dumps(EXTENSION).encode()}, "extended.json", "extended.json"
    if kind in ("policy", "weights"):
        folder = learned_folder("speed", "ppo_oblivious", 0)
        files = {path.name: path.read_bytes() for path in folder.iterdir()}
        return files, "policy.json" if kind == "policy" else "weights.npz", ""
    if kind == "checkpoint":
        return {CHECKPOINT: _checkpoint()}, CHECKPOINT, ""
    document = {"soil": SOIL, "vehicle": VEHICLE, "scenario": SCENARIO}[kind]
    return {f"{kind}.yaml": yaml.safe_dump(document).encode()}, f"{kind}.yaml", f"{kind}.yaml"


def _checkpoint() -> bytes:
    """A file with the head of a checkpoint and a state behind it."""
    from agents.learning.restricted_pickle import pack

    rest = pack(
        {"model": b"x" * 100, "counters": {}, "episodes": [np.arange(30.0)], "sums": (), "random": ()}
    )
    return checkpoint_file(rest)


def checkpoint_file(rest: bytes) -> bytes:
    """A checkpoint around any bytes, with the head that they need to be read."""
    import hashlib

    head = {
        "format": "offroad-checkpoint-2",
        "configuration": "c0ffee",
        "length": len(rest),
        "sha256": hashlib.sha256(rest).hexdigest(),
    }
    return f"{json.dumps(head)}\n".encode() + rest


# ------------------------------------------------------------------ mutations

#: What stands in places where nobody expects it.
TOKENS = [
    b"nan", b"inf", b"-inf", b"1e308", b"-1e308", b"1e-320", b"0", b"-1", b"true", b"null", b"~", b"''",
    b"[]", b"{}", b"!!bool 7", b"!!timestamp foo", b"!!binary x", b"!!int ''", b"!!float ''",
    b"!!set {a}", b"!!omap [a]", b"!!python/object/apply:os.system ['true']", b"&a [*a]", b"*nothing",
    b"<<: 3", b"? [a, b]\n: 1", b"0x" + b"f" * 5000, b"9" * 5000, b"\x00", b"\xff\xfe",
    b"\xf0\x9f\x9a\x9c", b"\x1b[2J", b"\"", b"'", b"\n", b"\r", b"\t", b",", b";", b"- " * 200,
    b"[" * 300, b"{" * 300, b"a" * 20000, b"2024-02-30", b"12:60:61", b"1_000", b"0o17", b".5e", b"\\",
    b"../../etc/passwd", b"/dev/zero", b"module:function", b"grid,ruts=some", b"__class__", b"%s%n",
    b"${HOME}",
]  # fmt: skip


def _mutate(content: bytes, rng: np.random.Generator) -> bytes:
    """One to four changes."""
    found = bytearray(content)
    for _ in range(int(rng.integers(1, 5))):
        if not found:
            break
        at = int(rng.integers(len(found)))
        length = int(rng.integers(1, max(2, min(200, len(found)))))
        match int(rng.integers(8)):
            case 0:
                for place in rng.integers(0, len(found), int(rng.integers(1, 9))):
                    found[place] = int(rng.integers(256))
            case 1:
                del found[at:]
            case 2:
                del found[at : at + length]
            case 3:
                found[at:at] = found[at : at + length] * int(rng.integers(1, 5))
            case 4:
                found[at : at + int(rng.integers(0, 12))] = TOKENS[int(rng.integers(len(TOKENS)))]
            case 5:
                _replace_number(found, rng)
            case 6:
                lines = bytes(found).split(b"\n")
                first, second = rng.integers(0, len(lines), 2)
                lines[first], lines[second] = lines[second], lines[first]
                found = bytearray(b"\n".join(lines))
            case _:
                found[at : at + 8] = rng.integers(0, 256, 8, dtype=np.uint8).tobytes()
    return bytes(found)


def _replace_number(found: bytearray, rng: np.random.Generator) -> None:
    """Another token in place of a number of text."""
    import re

    numbers = list(re.finditer(rb"-?\d+\.?\d*(e[-+]?\d+)?", bytes(found)))
    if numbers:
        number = numbers[int(rng.integers(len(numbers)))]
        found[number.start() : number.end()] = TOKENS[int(rng.integers(len(TOKENS)))]


def mutations(count: int, seed: int) -> Iterator[File]:
    """So many mutated files, all kinds in turn."""
    kinds = list(READERS)
    for i in range(count):
        kind = kinds[i % len(kinds)]

        def make(folder: Path, kind: str = kind, i: int = i) -> Path:
            files, mutated, taken = _good(kind)
            for name, content in files.items():
                changed = _mutate(content, np.random.default_rng((seed, i))) if name == mutated else content
                if kind == "checkpoint" and i % 2:  # the hash would refuse almost all: a hostile one fits
                    body = content.partition(b"\n")[2]
                    changed = checkpoint_file(_mutate(body, np.random.default_rng((seed, i))))
                (folder / name).write_bytes(changed)
            return folder / taken if taken else folder

        yield File(kind, f"{kind} {i}", make)


# ------------------------------------------------------------------ thought out


def crafted() -> list[File]:
    """Files that are dangerous by design."""
    found = [
        File(kind, f"{kind}: {name}", _described(kind, text))
        for name, text in _bombs().items()
        for kind in ("description", "soil", "vehicle", "scenario")
    ]
    for jump in (1e3, 1e6, 1.7e9):
        found += [File(kind, f"{kind}: clock jumps by {jump:g} s", _jump(jump)) for kind in ("csv", "check")]
    found += [
        File("csv", "csv: every tenth row a silence", _silences),
        File("csv", "csv: rate of years", _years),
    ]
    for kind, ending in (
        ("csv", "csv"),
        ("parquet", "parquet"),
        ("bag", "mcap"),
        ("soil", "yaml"),
        ("extension", "json"),
    ):
        found.append(File(kind, f"{kind}: FIFO", _fifo(f"run.{ending}")))
        found.append(File(kind, f"{kind}: endless device", _device(f"run.{ending}")))
    found += [
        File("parquet", "parquet: dictionary of one long text", _dictionary_bomb),
        File("parquet", "parquet: a billion rows", _rows_bomb),
        File("parquet", "parquet: an end that lies about the sizes", _lying_parquet),
        File("parquet", "parquet: text as differences", _differences),
        File("parquet", "parquet: kinds of values", _parquet_kinds),
        File("extension", "extension: nested", _text("extended.json", "[" * 100_000)),
        File("extension", "extension: nested objects", _text("extended.json", '{"a":' * 100_000)),
        File("extension", "extension: huge bias", _extension("accel_bias_x", bias=1e300)),
        File("extension", "extension: no number", _extension("payload", share=float("inf"))),
        File("extension", "extension: digits", _text("extended.json", "1" * 100_000)),
        File("policy", "policy: a list", _text("policy.json", "[]", folder=True)),
        File("policy", "policy: nested", _text("policy.json", "[" * 100_000, folder=True)),
        File("weights", "weights: empty", _weights(bytes)),
        File("weights", "weights: bomb", _weights(_array_bomb)),
        File("weights", "weights: a header that lies", _weights(_lying_array)),
        File("weights", "weights: Python objects", _weights(_objects)),
        File("weights", "weights: other shapes", _weights(_shapes)),
        File("csv", "csv: one endless line", _text_log("t" * 3_000_000)),
        File("csv", "csv: a million columns", _text_log(",".join(f"c{i}" for i in range(100_000)) + "\n1\n")),
        File("csv", "csv: rig of zeros", _rig_of_zeros),
    ]  # fmt: skip
    return found


def _bombs() -> dict[str, str]:
    laughs = "a0: &a0 [x, x, x, x, x, x, x, x, x]\n" + "".join(
        f"a{i}: &a{i} [{', '.join([f'*a{i - 1}'] * 9)}]\n" for i in range(1, 12)
    )
    merges = "b0: &b0 {k0: 1, j0: 2}\n" + "".join(
        f"b{i}: &b{i}\n  <<: [{', '.join([f'*b{i - 1}'] * 9)}]\n  k{i}: 1\n" for i in range(1, 12)
    )
    digits, name = "0x" + "f" * 5000, "x" * 100_000
    return {
        "aliases of aliases": laughs,
        "merges of merges": merges,
        "an alias of itself": "soil: &s {base: clay, more: *s}\nvehicle: *s\nscenario: *s\n",
        "a bomb as a value": f"{laughs}soil: {{base: clay, n: *a11}}\nvehicle: {{m: *a11}}\nscenario: *a11\n",
        "nested": "a: " + "[" * 5000,
        "many keys": "".join(f"k{i}: 1\n" for i in range(200_000)),
        "five thousand digits": f"soil: {{base: clay, n: {digits}}}\nvehicle: {{base: mrzr, m: {digits}}}\n",
        "wrong tags": "soil: {base: !!bool 7}\nvehicle: {m: !!timestamp foo}\nscenario: {base: !!int ''}\n",
        "code": "soil: !!python/object/apply:os.system ['true']\n",
        "a name of 100 kB": "".join(f"{kind}: {{{name}: 1}}\n" for kind in ("soil", "vehicle", "scenario")),
    }  # fmt: skip


def _described(kind: str, text: str) -> Callable[[Path], Path]:
    def make(folder: Path) -> Path:
        if kind == "description":
            write(folder, text_of(good_rows()), text)
            return folder / "run.csv"
        (folder / f"{kind}.yaml").write_text(text)
        return folder / f"{kind}.yaml"

    return make


def _with_times(change: Callable[[np.ndarray], np.ndarray]) -> Callable[[Path], Path]:
    def make(folder: Path) -> Path:
        head, *rows = good_rows()
        rows = rows * 10
        t = change(0.01 * np.arange(len(rows)))
        write(folder, text_of([head, *([repr(float(s)), *row[1:]] for s, row in zip(t, rows, strict=True))]))
        return folder / "run.csv"

    return make


def _jump(by: float) -> Callable[[Path], Path]:
    return _with_times(lambda t: t + by * (np.arange(len(t)) >= len(t) // 2))


_silences = _with_times(lambda t: t + 20.0 * (np.arange(len(t)) // 10))


def _years(folder: Path) -> Path:
    make = _with_times(lambda t: 99.0 * t)
    path = make(folder)
    text = yaml.safe_dump({**DESCRIPTION, "imu": {**DESCRIPTION["imu"], "rate": 1000}})
    (folder / "run.yaml").write_text(text)
    return path


def _fifo(name: str) -> Callable[[Path], Path]:
    def make(folder: Path) -> Path:
        (folder / "run.yaml").write_text(yaml.safe_dump(DESCRIPTION))
        path = folder / name.replace("run.yaml", "own.yaml")
        os.mkfifo(path)
        return path

    return make


def _device(name: str) -> Callable[[Path], Path]:
    def make(folder: Path) -> Path:
        (folder / "run.yaml").write_text(yaml.safe_dump(DESCRIPTION))
        path = folder / name.replace("run.yaml", "own.yaml")
        path.symlink_to("/dev/zero")
        return path

    return make


def _text(name: str, text: str, *, folder: bool = False) -> Callable[[Path], Path]:
    def make(place: Path) -> Path:
        (place / name).write_text(text)
        return place if folder else place / name

    return make


def _text_log(text: str) -> Callable[[Path], Path]:
    def make(folder: Path) -> Path:
        write(folder, text)
        return folder / "run.csv"

    return make


def _extension(effect: str, **values: float) -> Callable[[Path], Path]:
    content = {**EXTENSION, "effects": [{"id": effect, "parameters": values}]}
    return _text("extended.json", json.dumps(content))


def _rig_of_zeros(folder: Path) -> Path:
    def change(rows: list[list[str]]) -> None:
        for row in rows[1:]:
            row[:] = ["0.0"] * len(row)

    rig(change)(folder)
    return folder / "run.csv"


def _parquet(folder: Path, table: object, **options: object) -> Path:
    import pyarrow.parquet

    pyarrow.parquet.write_table(table, folder / "run.parquet", **options)
    (folder / "run.yaml").write_text(yaml.safe_dump(DESCRIPTION))
    return folder / "run.parquet"


def _dictionary_bomb(folder: Path) -> Path:
    import pyarrow

    column = pyarrow.DictionaryArray.from_arrays(
        pyarrow.array(np.zeros(1_000_000, np.int32)), pyarrow.array(["9" * 100_000])
    )
    return _parquet(folder, pyarrow.table({"t": np.arange(1e6), "steer": column}))


def _rows_bomb(folder: Path) -> Path:
    import pyarrow

    column = pyarrow.array(np.zeros(50_000_000, np.int8))
    return _parquet(folder, pyarrow.table({"t": column, "steer": column}))


def _varint(value: int) -> bytes:
    """A signed number of Thrift's compact protocol."""
    found, value = bytearray(), 2 * value
    while value > 127:
        found.append(128 | value & 127)
        value >>= 7
    return bytes([*found, value])


def _lying_parquet(folder: Path) -> Path:
    """A page that is far longer than the end of the file states."""
    import pyarrow
    import pyarrow.parquet

    size = 1_500_000_000
    page = pyarrow.compress(bytes(size), "zstd", asbytes=True)
    head = b"\x15\x00\x15" + _varint(size) + b"\x15" + _varint(len(page))
    page = head + b"\x2c\x15\x02\x15\x00\x15\x06\x15\x06\x00\x00" + page
    # Of the same number of digits as what it takes the place of.
    own = np.random.default_rng(0).bytes(len(page) // 2).hex()
    columns = pyarrow.table({"t": [0.0], "steer": [own]})
    path = _parquet(folder, columns, use_dictionary=False, compression="zstd", write_statistics=False)
    stated = pyarrow.parquet.ParquetFile(path).metadata.row_group(0).column(1)
    start, length = stated.data_page_offset, stated.total_compressed_size
    content = path.read_bytes()
    end = content[start + length :].replace(_varint(length), _varint(len(page)))
    path.write_bytes(content[:start] + page + end)
    return path


def _differences(folder: Path) -> Path:
    """Each text is the one before and a digit more: a page holds the square of its length."""
    import pyarrow

    texts = ["1" * i for i in range(2000)]
    columns = pyarrow.table({"t": np.arange(2000.0), "steer": texts})
    return _parquet(folder, columns, use_dictionary=False, column_encoding={"steer": "DELTA_BYTE_ARRAY"})


def _parquet_kinds(folder: Path) -> Path:
    import datetime

    import pyarrow

    return _parquet(
        folder,
        pyarrow.table(
            {
                "t": pyarrow.array([datetime.timedelta(seconds=s) for s in range(3)]),
                "steer": pyarrow.array([b"x", b"y", None]),
                "a_x": pyarrow.array([[1.0], None, []]),
                "a_y": pyarrow.array([{"x": 1}, None, {}], pyarrow.struct({"x": pyarrow.int8()})),
            }
        ),
    )


def _weights(content: Callable[[], bytes]) -> Callable[[Path], Path]:
    def make(folder: Path) -> Path:
        for name, own in _good("weights")[0].items():
            (folder / name).write_bytes(content() if name == "weights.npz" else own)
        return folder

    return make


def _zipped(name: str, content: bytes) -> bytes:
    sink = io.BytesIO()
    with zipfile.ZipFile(sink, "w", zipfile.ZIP_DEFLATED, compresslevel=1) as archive:
        archive.writestr(name, content)
    return sink.getvalue()


def _header(shape: tuple[int, ...], kind: str) -> bytes:
    sink = io.BytesIO()
    np.lib.format.write_array_header_1_0(sink, {"descr": kind, "fortran_order": False, "shape": shape})
    return sink.getvalue()


def _array_bomb() -> bytes:
    return _zipped("w0.npy", _header((64_000_000,), "<f8") + bytes(512_000_000))


def _lying_array() -> bytes:
    return _zipped("w0.npy", _header((10**12, 10**5), "<f8") + bytes(100))


def _objects() -> bytes:
    sink = io.BytesIO()
    np.savez(sink, w0=np.array([{}, []], dtype=object), b0=np.zeros(2))
    return sink.getvalue()


def _shapes() -> bytes:
    sink = io.BytesIO()
    np.savez(sink, w0=np.zeros((3, 4)), b0=np.zeros(7))
    return sink.getvalue()
