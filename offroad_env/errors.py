"""The small exception tree of the project: every error a user can cause is one of these."""

from __future__ import annotations

__all__ = ["DataError", "InvalidParameter", "OffroadError", "SolverFailure"]


class OffroadError(Exception):
    """Base of all errors that this project raises on purpose."""


class InvalidParameter(OffroadError, ValueError):
    """A parameter is outside the range in which the model means anything.

    The message names the parameter, its value, the allowed range and the likely mistake.
    """


class DataError(OffroadError, ValueError):
    """A file or download is missing, damaged or not in the expected format."""


class SolverFailure(OffroadError, ArithmeticError):
    """A numerical solve found no solution (for example a wheel sunk deeper than its radius)."""
