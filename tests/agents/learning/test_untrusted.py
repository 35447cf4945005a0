"""Files that a user may have been given do not run what stands in them."""

from __future__ import annotations

import io
import json
import pickle
import shutil
import zipfile
from collections import OrderedDict, deque
from dataclasses import replace

import numpy as np
import pytest
from fuzz_corpus import checkpoint_file
from gymnasium.vector import AutoresetMode

from agents.controllers.keyboard import KeyboardAgent, Keys
from agents.learning.checkpoint import CHECKPOINT, read_checkpoint
from agents.learning.policies import Network, learned_folder, load_policy
from agents.learning.restricted_pickle import pack, unpack
from agents.learning.train import TrainArgs, train
from offroad_env.environment.courses import CourseRecipe
from offroad_env.environment.env import OffroadBekkerEnv
from offroad_env.environment.scenarios import SCENARIOS, Scenario
from offroad_env.errors import DataError, InvalidParameter


class Payload:
    """What a pickle can do: here it only leaves a file."""

    def __init__(self, place):
        self.place = place

    def __reduce__(self):
        return (open, (str(self.place), "w"))


def deeper(place):
    """The same by the names of allowed modules: `os` as an attribute of one of them, and a function."""
    return [
        b"cagents.learning.train\nio.open\n(V" + str(place).encode() + b"\nVw\ntR.",
        b"cagents.learning.train\ntrain\n.",
        b"coffroad_env.environment.scenario_descriptions\nimportlib\n.",
        b"cbuiltins\neval\n(V1\ntR.",
        b"cnumpy\nload\n(V" + str(place).encode() + b"\ntR.",
    ]


def test_a_payload_runs_in_an_ordinary_pickle_and_not_here(tmp_path):
    marks = [tmp_path / "ordinary", tmp_path / "restricted"]
    pickle.loads(pickle.dumps(Payload(marks[0]))).close()
    assert marks[0].exists()
    for content in [pickle.dumps({"a": Payload(marks[1])}), *deeper(marks[1])]:
        # Refused by its name, before it is known what would be done with it.
        with pytest.raises(DataError, match=r"it names|has no attribute"):
            unpack(content, "x", SCENARIOS["speed"])
    assert not marks[1].exists()


_OWN_CLASS = b"cagents.controllers.keyboard\nKeyboardAgent\n"
_OTHER = b"cagents.learning.policies\nNetwork\n"
_EMPTY = _OWN_CLASS + b")\x81"
#: Fields that would stand for methods, of an object or of a class: another class is called through them.
DISGUISED = {
    "how an object takes its state": _EMPTY + b"}\x8c\x0c__setstate__" + _OTHER + b"sb\x8c\x03abcb.",
    "the same in slots": _EMPTY + b"N}\x8c\x0c__setstate__" + _OTHER + b"s\x86b\x8c\x03abcb.",
    "a method of a class": _OWN_CLASS + b"N}\x8c\x03act" + _OTHER + b"s\x86b.",
    "how a list grows by one": _EMPTY + b"}\x8c\x06append" + _OTHER + b"sb\x8c\x03abca.",
    "how a list grows": _EMPTY + b"}\x8c\x06extend" + _OTHER + b"sb(\x8c\x03abce.",
    "how a set grows": _EMPTY + b"}\x8c\x03add" + _OTHER + b"sb(\x8c\x03abc\x90.",
}


@pytest.mark.parametrize("content", DISGUISED.values(), ids=DISGUISED)
def test_no_field_stands_for_a_method(content, monkeypatch):
    called = []
    monkeypatch.setattr(Network, "__init__", lambda self, *given: called.append(given))
    act = KeyboardAgent.act
    with pytest.raises(DataError, match=r"it sets |changes a class|fills what is neither"):
        unpack(content, "x", SCENARIOS["speed"])
    assert not called
    assert KeyboardAgent.act is act


GREEDY = {
    "an array that begins large": b"cnumpy._core.multiarray\n_reconstruct\n(cnumpy\nndarray\n"
    b"(I1000000000000\nt\x8c\x01btR.",
    "a space of a terabyte": b"cgymnasium.spaces.box\nBox\n(I0\nI1\n(I1000000000000\nttR.",
    "the constructor of a class of this project": b"coffroad_env.environment.env\nOffroadBekkerEnv\n(tR.",
    "a constructor called by another opcode": b"(coffroad_env.environment.env\nOffroadBekkerEnv\no.",
    "a class called by the maker of bit generators": b"cnumpy.random._pickle\n__bit_generator_ctor\n"
    b"(coffroad_env.environment.env\nOffroadBekkerEnv\ntR.",
    "a class called by the maker of generators": b"cnumpy.random._pickle\n__generator_ctor\n"
    b"(Vhello\ncagents.controllers.keyboard\nKeyboardAgent\ntR.",
    "an array made by the maker of generators": b"cnumpy.random._pickle\n__generator_ctor\n"
    b"(I300000000\ncnumpy\nndarray\ntR.",
    "bytes that are not there": b"\x80\x05\x96" + (1 << 40).to_bytes(8, "little") + b"x.",
}


@pytest.mark.parametrize("content", GREEDY.values(), ids=GREEDY)
def test_a_checkpoint_calls_no_constructor_and_takes_no_more_room_than_it_has(content, capfd):
    with pytest.raises(DataError, match=r"it calls|another way|ends within an array"):
        unpack(content, "x", SCENARIOS["speed"])
    assert capfd.readouterr().err == ""  # what an interpreter writes where it cannot raise


class Made:
    """Is written as what a call returns, with a state set afterwards."""

    def __init__(self, function, *arguments, state=None):
        self.made = (function, arguments) if state is None else (function, arguments, state)

    def __reduce__(self):
        return self.made


def filled(kind, **fields):
    """An empty object with these fields, whatever its class would have of them."""
    made = object.__new__(kind)
    made.__dict__.update(fields)
    return made


def number_type(text, *, flags=0, **state):
    """A type of numbers as NumPy writes it, or with another state."""
    stated = {"base": None, "names": None, "fields": None, "size": -1, "align": -1, **state}
    return Made(np.dtype, text, False, True, state=(3, "|", *stated.values(), flags))


def array(shape, kind, content):
    """An array as NumPy writes one that is not contiguous."""
    start = (np.ndarray, (0,), b"b")
    return Made(np._core.multiarray._reconstruct, *start, state=(1, shape, kind, False, content))


def from_bytes(content, kind, shape):
    """An array as NumPy writes most."""
    return Made(np._core.numeric._frombuffer, content, kind, shape, "C")


F8, POINTERS = np.dtype("f8"), b"A" * 16
RECORD = {"names": ("a",), "fields": {"a": (np.dtype("O"), 0)}, "size": 8, "align": 1}
CORRUPTING = {
    "objects whose type has lost its flags": array((2,), number_type("O8"), POINTERS),
    "objects": array((2,), np.dtype("O"), [1, 2]),
    "objects of a list that is too short": array((9,), np.dtype("O"), []),
    "objects in records without flags": array((2,), number_type("V8", **RECORD), POINTERS),
    "a single object": Made(np._core.multiarray.scalar, number_type("O8"), POINTERS[:8]),
    "objects in a buffer": from_bytes(POINTERS, number_type("O8"), (2,)),
    "another size of records": array((2,), number_type("V8", base=(F8, (9,)), size=72, align=8), POINTERS),
    "fields beyond a record": from_bytes(
        POINTERS, number_type("V8", **{**RECORD, "fields": {"a": (F8, 800)}}), (2,)
    ),
    "flags of another type": from_bytes(POINTERS, number_type("f8", flags=63), (2,)),
    "text beyond what letters there are": from_bytes(b"\xff" * 16, np.dtype("U2"), (2,)),
    "fewer numbers than the shape has": array((3,), F8, POINTERS),
    "more numbers than the shape has": array((1,), F8, POINTERS),
    "a negative shape": array((-1, -2), F8, POINTERS),
    "truth values that are counted wrongly": array((16,), np.dtype("?"), POINTERS),
    "the same in a buffer": from_bytes(POINTERS, np.dtype("?"), (16,)),
    "an array over the memory of another": from_bytes(np.arange(2.0), F8, (2,)),
    "a single number of too many bytes": Made(np._core.multiarray.scalar, F8, POINTERS),
    "the type that all share": Made(np.dtype, "f8", state=(3, ">", None, None, None, -1, -1, 0)),
}


@pytest.mark.parametrize("crafted", CORRUPTING.values(), ids=CORRUPTING)
def test_no_bytes_of_a_checkpoint_are_read_as_something_else(crafted):
    words = r"is none|holds what are no numbers|with something else than a run does|cannot override"
    with pytest.raises(DataError, match=words):
        unpack(pickle.dumps({"a": crafted}, protocol=5), "x", SCENARIOS["speed"])


def test_an_array_and_a_type_are_filled_once():
    array_twice = b"cnumpy._core.multiarray\n_reconstruct\n(cnumpy\nndarray\n(I0\ntC\x01bt\x52"
    kind = b"cnumpy\ndtype\n(Vf8\nI00\nI01\ntR"
    state = b"(I3\nV<\nNNNI-1\nI-1\nI0\ntb"
    numbers = b"(I1\n(I1\nt" + kind + state + b"I00\nC\x08" + bytes(8) + b"tb"
    held = unpack(b"}Va\n" + array_twice + numbers + b"s.", "x", SCENARIOS["speed"])
    assert np.array_equal(held["a"], [0.0])
    for content in (array_twice + 2 * numbers, kind + 2 * state):
        with pytest.raises(DataError, match=r"it changes an array|it changes a type of numbers"):
            unpack(b"}Va\n" + content + b"s.", "x", SCENARIOS["speed"])


def disguised():
    """Objects with a class where what reads or uses them calls one, and what would let one in."""
    mapping = filled(Scenario, keys=OffroadBekkerEnv)
    plain = filled(Scenario, name="a")
    seeds = np.random.bit_generator.__pyx_unpickle_SeedSequence
    generator = np.random._pickle.__dict__["__bit_generator_ctor"]
    return {
        "a mapping of what calls its keys": Made(OrderedDict, mapping),
        "the same without a class": Made(OrderedDict, plain),
        "a mapping of pairs": Made(OrderedDict, [("a", 1)]),
        "fields of a mapping": Made(OrderedDict, state={"items": OffroadBekkerEnv}),
        "a queue of an object": Made(deque, plain),
        "a queue of no length": Made(deque, [], plain),
        "a class as a field": filled(Scenario, draw=OffroadBekkerEnv),
        "a function as a field": filled(Scenario, draw=np._core.numeric._frombuffer),
        "what can be called as a field": filled(Scenario, draw=filled(CourseRecipe, path="circle")),
        "a class in a tuple with names": Keys(*[OffroadBekkerEnv] * len(Keys._fields)),
        "other seeds": Made(seeds, OffroadBekkerEnv, 0, None),
        "seeds with a state of their own": Made(seeds, np.random.SeedSequence, 0, (1, 2, mapping)),
        "a state of seeds that is none": Made(
            seeds,
            np.random.SeedSequence,
            np.random.SeedSequence(0).__reduce__()[1][1],
            None,
            state=(plain,) * 5,
        ),
        "a state of a generator that is none": Made(generator, np.random.PCG64, state=plain),
        "a new kind of reset": Made(AutoresetMode, "x", [("a", plain)]),
        "a device of an object": Made(torch_device(), plain),
        "a slice of objects": Made(slice, plain, plain, plain),
    }


def torch_device():
    import torch

    return torch.device


@pytest.mark.parametrize("name", disguised())
def test_no_class_is_kept_where_it_would_be_called(name, monkeypatch):
    built = []
    monkeypatch.setattr(OffroadBekkerEnv, "__init__", lambda self, *given, **named: built.append(given))
    words = r"with something else|to a class or a function|as a value|sets fields of|the state of .* is none"
    with pytest.raises(DataError, match=words):
        unpack(pickle.dumps({"a": disguised()[name]}, protocol=5), "x", SCENARIOS["speed"])
    assert not built


@pytest.mark.parametrize(
    ("content", "words"),
    [
        (_EMPTY + pickle.dumps(filled(Scenario, items=3), 2)[2:-1] + b"b.", "fields of an object are none"),
        (_EMPTY + b"N" + pickle.dumps(filled(Scenario, items=3), 2)[2:-1] + b"\x86b.", "fields of an object"),
        (_EMPTY + b"}I1\nI2\nsb.", "it sets 1"),
        (_EMPTY + b"Va\nI1\ns.", "neither a list, a set nor a mapping"),
        (_EMPTY + b"(Va\nI1\nu.", "neither a list, a set nor a mapping"),
        (b"cnumpy\nndarray\n((I2\ntcnumpy\ndtype\n(VO8\nI00\nI01\ntRt\x81.", "with something else"),
        (b"cnumpy.random._pcg64\nPCG64\n)\x81.", "no class of a run"),
        (b"cnumpy\nndarray\n((I1000000000000\ntt\x81.", "no class of a run"),
        (b"cnumpy\ndtype\n(VO8\nt\x81.", "no class of a run"),
        (_OWN_CLASS + b"(I1\nt\x81.", "it calls KeyboardAgent with arguments"),
        (b"I1\n)\x81.", "no class of a run"),
        (b"\x80\x05\x97.", "another way"),
    ],
)
def test_what_no_pickle_of_a_run_does_is_refused(content, words):
    with pytest.raises(DataError, match=words):
        unpack(content, "x", SCENARIOS["speed"])


def test_all_kinds_of_numbers_of_a_run_come_back_the_same():
    record = np.dtype([("a", "f8", (2, 3)), ("b", "?"), ("c", "i4")], align=True)
    packed = np.dtype([("a", "f8"), ("inner", record)])
    rng = np.random.default_rng([3, 4])
    state = {
        "records": np.zeros(3, packed),
        "record": np.ones(1, record)[0],
        "empty": np.zeros((0, 3), "f4"),
        "strided": np.arange(12.0).reshape(3, 4)[::2, 1::2],
        "turned": np.arange(24).reshape(2, 3, 4).transpose(2, 0, 1),
        "columns": np.asfortranarray(np.eye(3, dtype="u2")),
        "flags": np.array([True, False]),
        "swapped": np.arange(3, dtype=">i8"),
        "number": np.float32(0.5),
        "queue": deque([1.0, 2.0], maxlen=3),
        "rng": rng,
        "child": rng.spawn(1)[0],
        "random": np.random.RandomState(3).get_state(),
        "place": slice(2, 5),
        "reset": AutoresetMode.SAME_STEP,
        "device": torch_device()("cpu"),
        "ordered": OrderedDict(a=1),
    }
    again = unpack(pack(state), "x", SCENARIOS["speed"])
    for name in ("records", "record", "empty", "strided", "turned", "columns", "flags", "swapped", "number"):
        assert again[name].dtype == state[name].dtype, name
        assert again[name].dtype.flags == state[name].dtype.flags, name
        assert np.array_equal(again[name], state[name]), name
    for name in ("queue", "place", "reset", "device", "ordered"):
        assert again[name] == state[name], name
    assert again["queue"].maxlen == 3
    for name in ("rng", "child"):
        assert again[name].spawn(1)[0].random() == state[name].spawn(1)[0].random()
    assert np.array_equal(again["random"][1], state["random"][1])


def test_a_crafted_checkpoint_runs_nothing(tmp_path):
    mark = tmp_path / "ran"
    (tmp_path / CHECKPOINT).write_bytes(checkpoint_file(pickle.dumps({"model": Payload(mark)})))
    with pytest.raises(DataError, match="no part of a training run"):
        read_checkpoint(tmp_path, "c0ffee", SCENARIOS["speed"])
    assert not mark.exists()


@pytest.mark.parametrize(
    ("change", "error", "words"),
    [
        (lambda content: content[:-3], DataError, "is damaged"),
        (lambda content: content.replace(b"c0ffee", b"c0ffe1"), InvalidParameter, "another configuration"),
        (lambda content: content.replace(b"checkpoint-2", b"checkpoint-9"), DataError, "another version"),
        (lambda content: b"", DataError, "no checkpoint of this version"),
        (lambda content: pickle.dumps({}), DataError, "no checkpoint of this version"),
        (lambda content: content[:-1] + bytes([content[-1] ^ 1]), DataError, "is damaged"),
    ],
    ids=["cut off", "of another run", "other version", "empty", "plain pickle", "one bit"],
)
def test_a_damaged_checkpoint_is_named_before_anything_of_it_is_read(tmp_path, change, error, words):
    (tmp_path / CHECKPOINT).write_bytes(change(checkpoint_file(pack({"model": b"x"}))))
    with pytest.raises(error, match=words):
        read_checkpoint(tmp_path, "c0ffee", SCENARIOS["speed"])


def test_what_the_state_of_a_run_holds_comes_back_the_same():
    state = {
        "a": np.arange(3.0),
        "b": (1, 2.0, "x"),
        "rng": np.random.default_rng(3),
        "task": SCENARIOS["speed"],
    }
    again = unpack(pack(state), "x", SCENARIOS["climb"])
    assert np.array_equal(again["a"], state["a"])
    assert again["b"] == state["b"]
    assert again["rng"].random() == state["rng"].random()
    assert again["task"] is SCENARIOS["climb"]  # that of the run, not a copy


SMALL = {
    "scenario": "brake",
    "terrain_info": "none",
    "total_steps": 96,
    "n_envs": 2,
    "threads": 1,
    "n_steps": 16,
    "batch_size": 16,
    "n_epochs": 1,
    "hidden": (8,),
    "buffer_size": 200,
    "checkpoint_steps": 32,
    "check_episodes": 0,
    "eval_episodes": 0,
}


@pytest.fixture(scope="module", params=[pytest.param("recurrent_ppo", marks=pytest.mark.check), "sac"])
def interrupted(request, tmp_path_factory):
    """A run with memory or a buffer that was interrupted, one that was not, and the first gone on with."""
    pytest.importorskip("sb3_contrib")

    class StopHereError(Exception):
        pass

    def interrupt(steps, _):
        if steps >= 64:
            raise StopHereError

    whole, broken = (
        TrainArgs(**SMALL, algorithm=request.param, out=tmp_path_factory.mktemp(name))
        for name in ("whole", "broken")
    )
    train(whole)
    with pytest.raises(StopHereError):
        train(broken, progress=interrupt)
    train(replace(broken, resume=True))
    return whole.out, broken.out


def tensors(folder):
    import torch

    with zipfile.ZipFile(folder / "policy.zip") as archive:
        found = torch.load(io.BytesIO(archive.read("policy.pth")), weights_only=True)
    return {name: value.numpy() for name, value in found.items()}


def test_runs_with_memory_go_on_as_if_they_had_not_been_interrupted(interrupted):
    whole, broken = (tensors(folder) for folder in interrupted)
    assert all(np.array_equal(value, broken[name]) for name, value in whole.items())


def test_a_crafted_zip_of_a_policy_runs_nothing(interrupted, tmp_path):
    """Stable-baselines3 keeps a pickle of the model in it, and torch one of the weights."""
    import base64

    mark = tmp_path / "ran"
    packed = base64.b64encode(pickle.dumps(Payload(mark))).decode()
    folder = tmp_path / "policy"
    shutil.copytree(interrupted[0], folder)
    with zipfile.ZipFile(folder / "policy.zip") as archive:
        parts = {name: archive.read(name) for name in archive.namelist()}
    parts["data"] = json.dumps({"policy_class": {":type:": "x", ":serialized:": packed}}).encode()
    write_zip(folder / "policy.zip", parts)
    load_policy(folder)  # the weights alone are read
    parts["policy.pth"] = pickle.dumps(Payload(mark))
    write_zip(folder / "policy.zip", parts)
    with pytest.raises(DataError, match="holds no weights of this model, or is damaged"):
        load_policy(folder)
    assert not mark.exists()


def write_zip(path, parts):
    with zipfile.ZipFile(path, "w") as archive:
        for name, content in parts.items():
            archive.writestr(name, content)


@pytest.mark.parametrize(
    ("key", "value", "words"),
    [
        ("algorithm", "dqn", "none that offroad train makes"),
        ("hidden", [10**9], "none that offroad train makes"),
        ("frames", 0, "frames must be in"),
        ("frames", "two", "frames is missing or of the wrong kind"),
        ("action_interface", None, "action_interface is missing"),
        ("terrain_info", 3, "terrain_info is missing or of the wrong kind"),
    ],
)
def test_settings_of_a_policy_that_cannot_be_are_named(tmp_path, key, value, words):
    source = learned_folder("speed", "ppo_oblivious", 0)
    for path in source.iterdir():
        (tmp_path / path.name).write_bytes(path.read_bytes())
    kind = json.loads((tmp_path / "policy.json").read_text(encoding="utf-8"))
    kind.pop("guide", None)  # alias
    kind[key] = value
    (tmp_path / "policy.json").write_text(json.dumps(kind), encoding="utf-8")
    with pytest.raises(DataError, match=words):
        load_policy(tmp_path)
