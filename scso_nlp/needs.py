"""What the terms of a problem need to know of a motion beyond static optimization's needs.

A term says it (:attr:`Term.needs <scso_nlp.frame.Term>`), reading a motion obeys
(:func:`~scso_nlp.load_motion`); neither needs CasADi or OpenSim for that.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from typing import Protocol

from scso_nlp.arguments import checked
from scso_nlp.exceptions import ArgumentError
from scso_nlp.text import shown


@dataclass(frozen=True, kw_only=True)
@checked
class MotionNeeds:
    """What is to be computed of a motion, as the fields of the same names of a ``MotionInput``.

    Attributes
    ----------
    muscle_paths : bool
        Points of muscle paths.
    stability_axes : tuple of (str, str)
        Joint and axis letter for which virtual rotations are computed; the joint "all" is every one.
    curvature_coordinates : tuple of str
        Coordinates along which second derivatives are computed; "all" is all that muscles depend on.
    joint_reactions : tuple of str
        Joints whose reactions are computed, by name or pattern; "all" is all.
    """

    muscle_paths: bool = False
    stability_axes: tuple[tuple[str, str], ...] = ()
    curvature_coordinates: tuple[str, ...] = ()
    joint_reactions: tuple[str, ...] = ()

    @property
    def needs(self) -> MotionNeeds:
        """Itself: it may stand for the terms that need it."""
        return self

    def __or__(self, other: MotionNeeds) -> MotionNeeds:
        return MotionNeeds(
            muscle_paths=self.muscle_paths or other.muscle_paths,
            stability_axes=tuple(dict.fromkeys(self.stability_axes + other.stability_axes)),
            curvature_coordinates=_united(self.curvature_coordinates, other.curvature_coordinates),
            joint_reactions=_united(self.joint_reactions, other.joint_reactions),
        )


def _united(one: tuple[str, ...], other: tuple[str, ...]) -> tuple[str, ...]:
    """Put names together, each once; "all" is all of them."""
    names = tuple(dict.fromkeys(one + other))
    return ("all",) if "all" in names else names


class HasNeeds(Protocol):
    """Whatever says what it needs of a motion: every term does."""

    @property
    def needs(self) -> MotionNeeds:
        """What is to be computed of a motion for it."""


def needs_of(terms: Iterable[HasNeeds]) -> MotionNeeds:
    """Unite what several terms need.

    Parameters
    ----------
    terms : iterable of terms

    Returns
    -------
    MotionNeeds

    Raises
    ------
    ArgumentError
        Something that is no term.
    """
    needs = MotionNeeds()
    for term in terms:
        found = getattr(term, "needs", None)
        if not isinstance(found, MotionNeeds):
            raise ArgumentError(f"{shown(term)} is no term, expected e.g. JointStability(q=5.0)")
        needs |= found
    return needs
