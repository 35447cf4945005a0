"""The command ``offroad``: finds the subcommand, parses its arguments, turns errors into sentences.

Nothing heavy is imported here, and a subcommand is imported only when it is called, so that
``offroad --help`` answers at once.
"""

from __future__ import annotations

import importlib
import os
import sys
from collections.abc import Sequence
from difflib import get_close_matches

from offroad_env.errors import InvalidParameter, OffroadError

__all__ = ["COMMANDS", "main"]

#: Subcommand -> (module of agents.commands with its argument class, name of that class, what it does).
COMMANDS: dict[str, tuple[str, str, str]] = {
    "demo": ("demo", "Demo", "run everything once, write one HTML page"),
    "drive": ("drive", "Drive", "drive one episode: plot, video or window"),
    "soil": ("soil", "SoilPlot", "force and sinkage curves of a soil; --list shows the catalogue"),
    "wheel-data": ("wheel_data", "WheelData", "measured against predicted forces of one wheel"),
    "diagnose": ("diagnose", "Diagnose", "what the simulation gets wrong in measured runs, and why"),
    "data": ("data", "Data", "list measured data sets, or get one from its publisher"),
    "train": ("train", "Train", "train a policy by PPO (needs the extra rl)"),
}

_USAGE = 2  # exit status of wrong usage, as argparse has it


def main(arguments: Sequence[str] | None = None) -> None:
    """Run ``offroad``; leaves by `SystemExit` with 0, 1 after an error, 2 after wrong usage."""
    # Small matrices everywhere: the threads of BLAS only wait for each other.
    for name in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS"):
        os.environ.setdefault(name, "1")
    sys.exit(_run(list(sys.argv[1:] if arguments is None else arguments)))


def _run(arguments: list[str]) -> int:
    if not arguments or arguments[0] in ("-h", "--help", "help"):
        print(_overview())
        return 0 if arguments else _USAGE
    name, rest = arguments[0], arguments[1:]
    if name == "--version":
        from offroad_env import __version__

        print(f"offroad {__version__}")
        return 0
    if name not in COMMANDS:
        near = get_close_matches(name, COMMANDS, n=1)
        hint = f"did you mean {near[0]!r}?" if near else f"known: {', '.join(COMMANDS)}"
        return _complain(f"no command {name!r} - {hint}", _USAGE)
    try:
        command = _parse(name, rest)
        if getattr(command, "seed", 0) < 0:
            raise InvalidParameter(f"seed must be >= 0, got {command.seed}")
        command.run()
    except OffroadError as error:
        return _complain(str(error), 1)
    except KeyboardInterrupt:
        return _complain("stopped", 130)
    except BrokenPipeError:  # the reader of a pipe, such as head, has seen enough
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
    return 0


def _parse(name: str, arguments: list[str]):
    """The arguments of a subcommand; leaves by `SystemExit` where they are wrong."""
    import tyro

    module, kind, _ = COMMANDS[name]
    return tyro.cli(
        getattr(importlib.import_module(f"agents.commands.{module}"), kind),
        prog=f"offroad {name}",
        args=arguments,
        config=(tyro.conf.FlagCreatePairsOff, tyro.conf.OmitArgPrefixes),
    )


def _complain(sentence: str, status: int) -> int:
    print(f"offroad: {' '.join(sentence.split())}", file=sys.stderr)
    return status


def _overview() -> str:
    width = max(map(len, COMMANDS))
    lines = [f"  {name:<{width}}  {summary}" for name, (_, _, summary) in COMMANDS.items()]
    return "\n".join(
        [
            "usage: offroad COMMAND [ARGUMENTS]",
            "",
            "Drive a vehicle on deformable soil, estimate the soil, compare controllers.",
            "",
            *lines,
            "",
            "offroad COMMAND --help explains a command; offroad --version names the version.",
        ]
    )


if __name__ == "__main__":
    main()
