"""Learned models of the motion that adapt to a soil: features by a network, weights by least squares.

Both predict the change of the motion over 0.1 s as g_0 + sum_k c_k g_k of motion and inputs, with g_0 ... g_K
from one network and c a vector that belongs to the soil.

- Function encoder: c by regularised least squares while the basis is trained, by recursive least squares on
  line (T. Ingebrand, A. J. Thorpe & U. Topcu, "Zero-shot transfer of neural ODEs", NeurIPS 2024; W. Ward et
  al., "Online adaptation of terrain-aware dynamics for planning in unstructured environments",
  arXiv:2506.04484, 2025).
- Meta-learned: c by a Kalman filter whose noise and prior are trained with the network, through the filter
  (J. Levy et al., "Meta-learning online dynamics model adaptation in off-road autonomous driving", Robotics:
  Science and Systems XXI, 2025).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import torch

from estimators.experiments.motion_sequences import AT, HORIZON, INPUTS, MOTION, STEP, DriveSequence

__all__ = ["METHODS", "Choice", "Model", "Tensors", "final_states", "tensors_of", "train"]

#: Ways of adapting.
METHODS = ("function_encoder", "meta_kalman")
_M, _U = len(MOTION), len(INPUTS)
#: Steps of a prediction, and steps over which a change is compared when c is found.
_AHEAD, _SPAN = round(HORIZON / STEP), 5
#: What an error of 1 m, 1 m/s and 1 rad counts in training.
_WEIGHTS = (1.0, 1.0, 3.0)
_RATE, _BATCH, _CHECK_EVERY, _CLIP = 2e-3, 32, 50, 1.0


@dataclass(frozen=True, kw_only=True)
class Choice:
    """What is tuned."""

    width: int = 64  #: of the two hidden layers
    size: int = 8  #: K, the numbers that belong to a soil


@dataclass(frozen=True, kw_only=True)
class Tensors:
    """Drives, stacked; see `estimators.experiments.motion_sequences.DriveSequence`."""

    true: torch.Tensor  #: (B, T, 5)
    measured: torch.Tensor  #: (B, T, 5)
    inputs: torch.Tensor  #: (B, T - 1, 2)
    place: torch.Tensor  #: (B, T, 3)

    def rows(self, index: torch.Tensor) -> Tensors:
        """Some of the drives."""
        return Tensors(
            true=self.true[index],
            measured=self.measured[index],
            inputs=self.inputs[index],
            place=self.place[index],
        )


def tensors_of(drives: Sequence[DriveSequence]) -> Tensors:
    """Drives of equal length as tensors."""

    def stacked(name: str) -> torch.Tensor:
        return torch.tensor(np.stack([getattr(drive, name) for drive in drives]), dtype=torch.float32)

    return Tensors(
        true=stacked("true"),
        measured=stacked("measured"),
        inputs=stacked("inputs"),
        place=stacked("place"),
    )


class Model(torch.nn.Module):
    """Change of the motion over a step, g_0 + sum c_k g_k, and what adapts c."""

    centre: torch.Tensor
    scale: torch.Tensor
    change: torch.Tensor
    span: torch.Tensor

    def __init__(self, choice: Choice, drives: Tensors) -> None:
        super().__init__()
        self.choice = choice
        self.net = torch.nn.Sequential(
            torch.nn.Linear(_M + _U, choice.width),
            torch.nn.SiLU(),
            torch.nn.Linear(choice.width, choice.width),
            torch.nn.SiLU(),
            torch.nn.Linear(choice.width, _M * (1 + choice.size)),
        )
        both = torch.cat([drives.true[:, :-1], drives.inputs], dim=-1)
        change = drives.true[:, 1:] - drives.true[:, :-1]
        span = drives.measured[:, _SPAN:] - drives.measured[:, :-_SPAN]
        self.register_buffer("centre", both.mean(dim=(0, 1)))
        self.register_buffer("scale", both.std(dim=(0, 1)) + 1e-6)
        self.register_buffer("change", change.std(dim=(0, 1)) + 1e-6)
        self.register_buffer("span", span.std(dim=(0, 1)) + 1e-6)
        # Of the Kalman filter, all learnt: prior, random walk and noise, as logarithms of deviations.
        self.log_prior = torch.nn.Parameter(torch.zeros(choice.size))
        self.log_walk = torch.nn.Parameter(torch.full((choice.size,), -3.0))
        self.log_noise = torch.nn.Parameter(torch.full((_M,), -0.5))

    def forward(self, motion: torch.Tensor, inputs: torch.Tensor) -> tuple[torch.Tensor, torch.Tensor]:
        """(..., 5) and (..., 5, K): g_0 and the basis, of motion (..., 5) and inputs (..., 2)."""
        x = (torch.cat([motion, inputs], dim=-1) - self.centre) / self.scale
        # No extrapolation far beyond what was seen.
        out = self.net(5.0 * torch.tanh(x / 5.0)).unflatten(-1, (_M, 1 + self.choice.size))
        out = out * self.change.unsqueeze(-1)
        return out[..., 0], out[..., 1:]

    def regression(self, drives: Tensors, until: int) -> tuple[torch.Tensor, torch.Tensor]:
        """(B, S, 5, K) and (B, S, 5): rows and targets of c, from spans that do not overlap.

        The change of what is measured over a span is the sum of the model's changes at what is measured: a
        span has one noise only, however many steps.
        """
        spans = until // _SPAN
        steps = spans * _SPAN
        offset, basis = self(drives.measured[:, :steps], drives.inputs[:, :steps])
        shape = (-1, spans, _SPAN)
        ends = drives.measured[:, : steps + 1 : _SPAN]
        found = ends[:, 1:] - ends[:, :-1] - offset.reshape(*shape, _M).sum(dim=2)
        rows = basis.reshape(*shape, _M, self.choice.size).sum(dim=2)
        return rows / self.span[:, None], found / self.span

    def adapted(self, drives: Tensors, until: int, method: str) -> torch.Tensor:
        """(B, K) numbers of the soil from what was measured until a step."""
        rows, targets = self.regression(drives, until)
        return self.least_squares(rows, targets) if method == METHODS[0] else self.filtered(rows, targets)

    def least_squares(self, rows: torch.Tensor, targets: torch.Tensor) -> torch.Tensor:
        """What recursive least squares from c = 0 with the covariance 1 have found in the end, at once."""
        A = torch.einsum("bsmk,bsml->bkl", rows, rows) + torch.eye(self.choice.size)
        found: torch.Tensor = torch.linalg.solve(A, torch.einsum("bsmk,bsm->bk", rows, targets))
        return found

    def filtered(self, rows: torch.Tensor, targets: torch.Tensor) -> torch.Tensor:
        """Kalman filter over the spans."""
        count = len(rows)
        P = torch.diag(torch.exp(2.0 * self.log_prior)).expand(count, -1, -1)
        walk, R = torch.diag(torch.exp(2.0 * self.log_walk)), torch.diag(torch.exp(2.0 * self.log_noise))
        c = torch.zeros(count, self.choice.size)
        for s in range(rows.shape[1]):
            H = rows[:, s]
            P = P + walk
            PH = P @ H.transpose(1, 2)
            gain = torch.linalg.solve(H @ PH + R, PH.transpose(1, 2)).transpose(1, 2)
            c = c + (gain @ (targets[:, s] - (H @ c.unsqueeze(-1)).squeeze(-1)).unsqueeze(-1)).squeeze(-1)
            P = P - gain @ PH.transpose(1, 2)
            P = 0.5 * (P + P.transpose(1, 2))
        return c

    def rollout(self, drives: Tensors, start: int, c: torch.Tensor, steps: int = _AHEAD) -> torch.Tensor:
        """(B, steps, 4) X, Y, heading and speed from the true motion at a step, under the inputs to come."""
        motion, place, found = drives.true[:, start], drives.place[:, start], []
        for k in range(start, start + steps):
            offset, basis = self(motion, drives.inputs[:, k])
            after = motion + offset + (basis @ c.unsqueeze(-1)).squeeze(-1)
            v_x, v_y, rate = (0.5 * (motion + after))[:, :3].unbind(-1)
            heading = place[:, 2] + 0.5 * STEP * rate
            cos, sin = torch.cos(heading), torch.sin(heading)
            place = place + STEP * torch.stack([v_x * cos - v_y * sin, v_x * sin + v_y * cos, rate], dim=-1)
            motion = after
            found.append(torch.cat([place, motion[:, :1]], dim=-1))
        return torch.stack(found, dim=1)


def _loss(found: torch.Tensor, drives: Tensors, start: int) -> torch.Tensor:
    """Mean size of the errors along predictions, position, speed and heading together."""
    rows = slice(start + 1, start + 1 + found.shape[1])
    place, speed = drives.place[:, rows], drives.true[:, rows, 0]
    away = torch.sqrt(((found[..., :2] - place[..., :2]) ** 2).sum(dim=-1) + 1e-6)
    parts = (away, (found[..., 3] - speed).abs(), (found[..., 2] - place[..., 2]).abs())
    total = sum(weight * part.mean() for weight, part in zip(_WEIGHTS, parts, strict=True))
    return torch.as_tensor(total)


def train(choice: Choice, method: str, drives: Tensors, check: Tensors, *, rounds: int, seed: int) -> Model:
    """A model trained for predictions of 3 s after a random time of adaptation.

    The parameters kept are those with the least error of position on ``check`` after 5 s.
    """
    torch.manual_seed(seed)
    rng = np.random.default_rng(seed)
    model = Model(choice, drives)
    optimiser = torch.optim.Adam(model.parameters(), lr=_RATE)
    schedule = torch.optim.lr_scheduler.OneCycleLR(optimiser, _RATE, total_steps=rounds)
    best, kept = float("inf"), {name: value.clone() for name, value in model.state_dict().items()}
    for i in range(rounds):
        index = torch.as_tensor(rng.integers(len(drives.true), size=_BATCH))
        batch, until = drives.rows(index), int(rng.integers(2 * _SPAN, round(AT[-1] / STEP) + 1))
        start = int(rng.integers(0, drives.true.shape[1] - 1 - _AHEAD))
        loss = _loss(model.rollout(batch, start, model.adapted(batch, until, method)), batch, start)
        optimiser.zero_grad()
        torch.autograd.backward(loss)
        torch.nn.utils.clip_grad_norm_(model.parameters(), _CLIP)
        optimiser.step()
        schedule.step()
        if (i + 1) % _CHECK_EVERY == 0:
            error = float(np.mean(_away(model, check, method)))
            if error < best:
                best, kept = error, {name: value.clone() for name, value in model.state_dict().items()}
    model.load_state_dict(kept)
    return model


def final_states(model: Model, drives: Tensors, method: str, at: float) -> np.ndarray:
    """(B, 4) X, Y, heading, speed 3 s after a time ``at`` [s] until which the model has adapted."""
    with torch.no_grad():
        start = round(at / STEP)
        found: np.ndarray = model.rollout(drives, start, model.adapted(drives, start, method))[:, -1].numpy()
    return found


def _away(model: Model, drives: Tensors, method: str) -> np.ndarray:
    """(B,) errors of position after 5 s [m]."""
    row = round((AT[1] + HORIZON) / STEP)
    end, truth = final_states(model, drives, method, AT[1]), drives.place[:, row].numpy()
    away: np.ndarray = np.hypot(end[:, 0] - truth[:, 0], end[:, 1] - truth[:, 1])
    return away
