# ruff: noqa: N818 -- the names say what is invalid, and are part of the public interface
"""Exceptions of the package.

Only mistakes made at design time raise: impossible limits, wrong shapes, unknown solvers. Bad
*values* inside the control loop never do; they are answered with a status and a fallback.
"""

__all__ = ["InvalidLimits", "InvalidProblem", "MissingDependency", "ShieldError"]


class ShieldError(Exception):
    """Base of every exception raised by `shield`."""


class InvalidLimits(ShieldError, ValueError):
    """A bound that no command can satisfy, or that is not a number."""


class InvalidProblem(ShieldError, ValueError):
    """An argument whose shape, type or name does not fit the problem."""


class MissingDependency(ShieldError, ImportError):
    """An optional package is not installed; the message is the pip line that brings it."""
