"""Files that a user may have been given do not run what stands in them."""

from __future__ import annotations

import io
import json
import pickle
import shutil
import zipfile
from dataclasses import replace

import numpy as np
import pytest
from fuzz_corpus import checkpoint_file

from agents.controllers.keyboard import KeyboardAgent
from agents.learning.checkpoint import CHECKPOINT, read_checkpoint
from agents.learning.policies import Network, learned_folder, load_policy
from agents.learning.restricted_pickle import pack, unpack
from agents.learning.train import TrainArgs, train
from offroad_env.environment.scenarios import SCENARIOS
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
    with pytest.raises(DataError, match=r"it sets __|changes a class|fills what is neither"):
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
    with pytest.raises(DataError, match=r"it calls|begin empty|another way|ends within an array"):
        unpack(content, "x", SCENARIOS["speed"])
    assert capfd.readouterr().err == ""  # what an interpreter writes where it cannot raise


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
