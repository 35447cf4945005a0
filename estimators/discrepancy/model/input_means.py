"""Means of a logged input over the steps of a simulation."""

from __future__ import annotations

import numpy as np

__all__ = ["input_means"]


def input_means(t: np.ndarray, values: np.ndarray, edges: np.ndarray, *, linear: bool) -> np.ndarray:
    """Mean of an input over every step, (K,) [its unit].

    Parameters
    ----------
    t, values
        Samples of the input, (N,) each [s, its unit].
    edges
        Where the steps begin and end, (K + 1,) [s], all of one length.
    linear
        The input goes straight from sample to sample; else each is held until the next.
    """
    t = np.concatenate([[min(t[0], edges[0]) - 1.0], t, [max(t[-1], edges[-1]) + 1.0]])
    if linear:
        values = np.concatenate([values[:1], values, values[-1:]])
        middle = 0.5 * (edges[1:] + edges[:-1])
        ends = np.interp(edges, t, values)
        simpson: np.ndarray = (ends[1:] + 4.0 * np.interp(middle, t, values) + ends[:-1]) / 6.0
        return simpson
    held = np.concatenate([values[:1], values])
    integral = np.concatenate([[0.0], np.cumsum(held * np.diff(t))])
    return np.asarray(np.diff(np.interp(edges, t, integral)) / np.diff(edges))
