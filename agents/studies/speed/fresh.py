"""What a new interpreter pays: imports, the first step, compilation, memory."""

from __future__ import annotations

import os
import subprocess
import sys
import tempfile
from dataclasses import dataclass

import numpy as np

from offroad_env.environment.env import OffroadBekkerEnv

__all__ = ["Fresh", "measure_fresh"]


@dataclass(frozen=True, kw_only=True)
class Fresh:
    """What an interpreter says that has imported nothing yet."""

    import_s: float  #: import offroad_env [s]
    import_others_s: float  #: import gymnasium, numba, scipy [s]
    first_step_s: float  #: make, reset and first step, everything compiled before [s]
    compile_s: tuple[float, float] | None  #: CPU and clock, with nothing compiled [s]; None when left out
    compile_filter_s: tuple[float, float] | None  #: the same of an environment with the parameter UKF
    peak_mb: float  #: memory of one environment after 300 steps [MB]
    per_environment_kb: float  #: by how much that grows with each environment of a vector [kB]
    state_kb: float  #: of it the record of an episode [kB]


_PEAK = """
def peak():
    try:
        return next(int(l.split()[1]) for l in open("/proc/self/status") if l.startswith("VmHWM")) / 1024
    except OSError:
        import resource, sys
        unit = 2**20 if sys.platform == "darwin" else 2**10
        return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / unit
"""
_IMPORT = "import time; t = time.process_time(); import {}; print(time.process_time() - t)"
_STEP = """
import time; clock, cpu = time.perf_counter(), time.process_time()
import gymnasium as gym, numpy as np
env = gym.make("offroad_env:OffroadBekker-v0", scenario="speed", terrain_info="{terrain_info}")
env.reset(seed=0); env.step(np.zeros(2, np.float32))
print(time.process_time() - cpu, time.perf_counter() - clock)
"""
_ONE = """
import gymnasium as gym, numpy as np
env = gym.make("offroad_env:OffroadBekker-v0", scenario="speed")
env.reset(seed=0)
for _ in range(300):
    _, _, terminated, truncated, _ = env.step(np.array([0.0, 0.3], np.float32))
    if terminated or truncated: env.reset()
print(peak())
"""
_MANY = """
import numpy as np
from offroad_env.environment.vector_env import make_vec
envs = make_vec({count}, scenario="speed"); envs.reset(seed=0)
for _ in range(20): envs.step(np.zeros(({count}, 2)))
print(peak())
"""


def _fresh(code: str, **environment: str) -> tuple[float, ...]:
    """The numbers that ``code`` prints last in a new interpreter, which keeps the bytecode of its modules.

    Where a variable forbids that, every interpreter would translate all of them once more.
    """
    kept = {name: value for name, value in os.environ.items() if name != "PYTHONDONTWRITEBYTECODE"}
    done = subprocess.run(
        [sys.executable, "-c", code],
        capture_output=True,
        text=True,
        check=True,
        env={**kept, **environment},
    )
    return tuple(float(number) for number in done.stdout.splitlines()[-1].split())


def _first_step(terrain_info: str) -> tuple[float, float]:
    """CPU time and clock [s] of make, reset and first step where nothing is compiled."""
    with tempfile.TemporaryDirectory() as folder:
        cpu, clock = _fresh(_STEP.format(terrain_info=terrain_info), OFFROAD_CACHE=folder)
        return cpu, clock


def measure_fresh(*, rounds: int, cold: bool) -> Fresh:
    """What new interpreters say; ``cold`` also compiles everything once more, into a folder of its own."""
    _fresh(_STEP.format(terrain_info="none"))  # modules are translated, and everything compiled, now
    imports = [
        (*_fresh(_IMPORT.format("offroad_env")), *_fresh(_IMPORT.format("gymnasium, numba, scipy")))
        for _ in range(rounds)
    ]
    few, many = 64, 512
    grown = [_fresh(_PEAK + _MANY.format(count=count))[0] for count in (few, many)]
    env = OffroadBekkerEnv()
    ours, others = np.median(imports, axis=0)
    return Fresh(
        import_s=float(ours),
        import_others_s=float(others),
        first_step_s=min(_fresh(_STEP.format(terrain_info="none"))[0] for _ in range(rounds)),
        compile_s=_first_step("none") if cold else None,
        compile_filter_s=_first_step("estimate") if cold else None,
        peak_mb=_fresh(_PEAK + _ONE)[0],
        per_environment_kb=1024.0 * (grown[1] - grown[0]) / (many - few),
        state_kb=env.memory_size / 1024.0,
    )
