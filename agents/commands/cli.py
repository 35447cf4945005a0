"""The command ``offroad``: finds the subcommand, parses its arguments, turns errors into sentences.

Nothing heavy is imported here, and a subcommand is imported only when it is called, so that
``offroad --help`` answers at once.
"""

from __future__ import annotations

import contextlib
import importlib
import io
import logging
import os
import sys
import warnings
from collections.abc import Iterable, Sequence
from difflib import get_close_matches
from typing import Any, Protocol

from threadpoolctl import threadpool_limits

from offroad_env.errors import InvalidParameter, OffroadError

__all__ = ["COMMANDS", "main"]

#: Subcommand -> (module of agents.commands with its argument class, name of that class, what it does).
#: In place of a class there may be a table of studies, one of which the next word names.
COMMANDS: dict[str, tuple[str, str, str]] = {
    "demo": ("demo", "Demo", "run everything once, write one HTML page"),
    "drive": ("drive", "Drive", "drive one episode: plot, video, window or log"),
    "estimate": ("estimate", "Estimate", "estimate the soil from logs of drives"),
    "log": ("log", "LogTools", "logs of a vehicle of your own: template, check, draw"),
    "replay": ("replay", "ReplayCommand", "predict logs open loop with several models, side by side"),
    "identify": ("identify", "Identify", "which soil parameters a drive can tell apart"),
    "soil": ("soil", "SoilPlot", "force and sinkage curves of a soil; --list shows the catalogue"),
    "keys": ("keys", "Keys", "what the YAML of a soil, vehicle, scenario, ... of your own may hold"),
    "wheel-data": ("wheel_data", "WheelData", "measured against predicted forces of one wheel"),
    "reproduce": ("reproduce", "STUDIES", "repeat a study: the paper's table, ..."),
    "speed": ("speed", "SpeedCommand", "speed and memory, as ratios to other environments"),
    "benchmark": (
        "benchmark",
        "BenchmarkRun",
        "does knowing the soil pay? arms on the same episodes",
    ),
    "compare": ("compare", "Compare", "an agent of your own against the arms, on the same episodes"),
    "diagnose": ("diagnose", "Diagnose", "what the simulation gets wrong in measured runs, and why"),
    "data": ("data", "Data", "list measured data sets, or get one from its publisher"),
    "train": ("train", "Train", "train a policy by PPO (needs the extra rl)"),
}

#: Other names of subcommands.
_ALIASES = {"study": "reproduce"}


class Command(Protocol):
    """The parsed arguments of a subcommand or study."""

    def run(self) -> None:
        """Do what was asked for."""


_USAGE = 2  # exit status of wrong usage, as argparse has it


def main(arguments: Sequence[str] | None = None) -> None:
    """Run ``offroad``; leaves by `SystemExit` with 0, 1 after an error, 2 after wrong usage."""
    _use_one_thread()
    _open_streams()
    _silence_side_effects()
    sys.exit(_run(list(sys.argv[1:] if arguments is None else arguments)))


def _use_one_thread() -> None:
    """One thread of BLAS, if the user does not ask for others: with small matrices they wait for each other.

    What is loaded by now has read the environment before; what is loaded later, and other processes, read it.
    """
    own = {"OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS"}
    if not own & set(os.environ):
        threadpool_limits(limits=1, user_api="blas")
    for name in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS"):
        os.environ.setdefault(name, "1")


def _open_streams() -> None:
    """Streams that take every sign, in any locale; a closed one swallows what is written."""
    for name in ("stdout", "stderr"):
        stream = getattr(sys, name)
        if stream is None:
            setattr(sys, name, open(os.devnull, "w", encoding="utf-8"))  # noqa: SIM115 - for the whole run
        elif isinstance(stream, io.TextIOWrapper):
            stream.reconfigure(errors="replace")


def _silence_side_effects() -> None:
    """A command that fails says so in one sentence; what its libraries lose by that is no news.

    matplotlib cannot keep its list of fonts on a full disk, and joblib cancels runs that nobody waits for.
    """
    logging.getLogger("matplotlib.font_manager").setLevel(logging.CRITICAL)
    warnings.filterwarnings("ignore", message=".*tasks which were still being processed")


def _run(arguments: list[str]) -> int:
    """The exit status; errors of the system become sentences."""
    try:
        status = _run_command(arguments)
        sys.stdout.flush()
        return status
    except BrokenPipeError:  # the reader of a pipe, such as head, has seen enough
        return _drop_output(0)
    except OSError as error:
        place = f" {error.filename}" if error.filename else ""
        return _drop_output(_complain(f"cannot write{place}: {error.strerror or error}", 1))
    except MemoryError:
        return _complain("not enough memory", 1)


def _drop_output(status: int) -> int:
    """What could not be written is lost: the end of the interpreter must not try again."""
    with contextlib.suppress(OSError, ValueError):
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
    return status


def _run_command(arguments: list[str]) -> int:
    arguments, engine = _take_engine(arguments)
    if not arguments or arguments[0] in ("-h", "--help", "help"):
        print(_overview())
        return 0 if arguments else _USAGE
    name, rest = _ALIASES.get(arguments[0], arguments[0]), arguments[1:]
    if name == "--version":
        from offroad_env import __version__

        print(f"offroad {__version__}")
        return 0
    if name not in COMMANDS:
        return _complain(f"no command {name!r} - {_hint(name, COMMANDS)}", _USAGE)
    try:
        command = _parse(name, rest)
        seed: int = getattr(command, "seed", 0)
        if seed < 0:
            raise InvalidParameter(f"seed must be >= 0, got {seed}")
        if engine == "local":
            command.run()
        else:
            from agents.commands.engine import using_engine

            with using_engine(engine):
                command.run()
    except OffroadError as error:
        return _complain(str(error), 1)
    except KeyboardInterrupt as stop:
        return _complain(f"stopped: {stop}" if str(stop) else "stopped", 130)
    return 0


def _take_engine(arguments: list[str]) -> tuple[list[str], str]:
    """The arguments without ``--engine NAME``, which belongs to no command, and NAME."""
    rest: list[str] = []
    engine = "local"
    words = iter(arguments)
    for word in words:
        if word == "--engine":
            named = next(words, None)
            if named is None:
                sys.exit(_complain("--engine needs a name: local, dask or ray", _USAGE))
            engine = named
        elif word.startswith("--engine="):
            engine = word.removeprefix("--engine=")
        else:
            rest.append(word)
    return rest, engine


def _parse(name: str, arguments: list[str]) -> Command:
    """The arguments of a subcommand; leaves by `SystemExit` where they are wrong."""
    import tyro

    from agents.commands.options import present_spelling

    arguments = present_spelling(arguments)
    module, kind, _ = COMMANDS[name]
    study = what = ""
    target: Any = getattr(importlib.import_module(f"agents.commands.{module}"), kind)
    if isinstance(target, dict):
        from agents.commands.reproduce import STUDY_ALIASES

        study, arguments = _choose_study(name, target, STUDY_ALIASES, arguments)
        module, kind, what = target[study]
        target = getattr(importlib.import_module(f"agents.studies.{module}.study"), kind)
        name = f"{name} {study}"
    describe = getattr(target, "description", None)
    command: Command = tyro.cli(
        target,
        description=None if describe is None else describe(arguments),
        prog=f"offroad {name}",
        args=arguments,
        config=(tyro.conf.FlagCreatePairsOff, tyro.conf.OmitArgPrefixes),
    )
    if not study:
        return command
    from agents.commands.study_run import StudyRun

    return StudyRun(command, study, what)


def _choose_study(
    name: str, studies: dict[str, tuple[str, str, str]], aliases: dict[str, str], arguments: list[str]
) -> tuple[str, list[str]]:
    """(study, its arguments); leaves by `SystemExit` after the help, or where no study is named."""
    if not arguments or arguments[0] in ("-h", "--help"):
        also = ", ".join(f"{alias} = {study}" for alias, study in aliases.items())
        lines = [
            f"usage: offroad {name} STUDY [ARGUMENTS]",
            "",
            *_listing(studies),
            "",
            f"Other names: {also}",
        ]
        print("\n".join(lines))
        sys.exit(0 if arguments else _USAGE)
    study, rest = aliases.get(arguments[0], arguments[0]), arguments[1:]
    if study not in studies:
        sys.exit(_complain(f"no study {study!r} - {_hint(study, [*studies, *aliases])}", _USAGE))
    return study, rest


def _hint(word: str, known: Iterable[str]) -> str:
    near = get_close_matches(word, known, n=1)
    return f"did you mean {near[0]!r}?" if near else f"known: {', '.join(known)}"


def _listing(entries: dict[str, tuple[str, str, str]]) -> list[str]:
    width = max(map(len, entries))
    return [f"  {name:<{width}}  {summary}" for name, (_, _, summary) in entries.items()]


def _complain(sentence: str, status: int) -> int:
    from agents.reports.output import printable

    print(f"offroad: {printable(' '.join(sentence.split()))}", file=sys.stderr)
    return status


def _overview() -> str:
    return "\n".join(
        [
            "usage: offroad COMMAND [ARGUMENTS]",
            "",
            "Drive a vehicle on deformable soil, estimate the soil, compare controllers.",
            "",
            *_listing(COMMANDS),
            "",
            "offroad COMMAND --help explains a command; offroad --version names the version.",
            "--engine local|dask|ray, with any command: where the runs of a study are computed.",
        ]
    )


if __name__ == "__main__":
    main()
