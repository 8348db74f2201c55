"""Equations of a frame that follow from its others: taken out, because multipliers would not be unique."""

from __future__ import annotations

import logging
from dataclasses import replace

import numpy as np
from scipy.linalg import qr

from scso_nlp.solver.threads import one_thread
from scso_nlp.transcription.describe import FrameProgram
from scso_nlp.transcription.piece import frame_blocks
from scso_nlp.validation import BoolArray, FloatArray

_LOG = logging.getLogger("scso_nlp")

#: A row counts as a sum of others if less than this share of it is left over [-].
REDUNDANT = 1e-9
#: Squares of shares below this are looked at more closely: they have lost half of their digits [-].
_SUSPICIOUS = 1e-12


def without_redundant_rows(program: FrameProgram) -> FrameProgram:
    """Free affine equations of one frame that are sums of others; the judge looks at them all the same.

    Parameters
    ----------
    program : FrameProgram

    Returns
    -------
    FrameProgram
        The same if there are none. A frame whose equations contradict each other misses those that are freed.
    """
    affine, rows = program.split.affine, program.rows
    equations = np.flatnonzero((rows.lower == rows.upper)[affine.rows])
    if not equations.size:
        return program
    lower, upper = program.bounds()
    freed: BoolArray = np.zeros_like(affine.is_empty)
    for part in frame_blocks(len(freed)):
        matrix = affine.frames(part).dense(program.layout.size)[:, equations]
        freed[part, equations] = _redundant(matrix * (lower[part] < upper[part])[:, None, :])
    freed &= ~affine.is_empty
    if not freed.any():
        return program
    found = [rows.find(int(affine.rows[i])) for i in np.flatnonzero(freed.any(axis=0))]
    _LOG.info(
        "%s: %s follow from the other equations in %d frames and are left out there",
        program.problem.motion.name,
        ", ".join(f"{block.term}[{block.names[place]}]" for block, place in found),
        int(freed.any(axis=1).sum()),
    )
    split = replace(program.split, affine=replace(affine, is_empty=affine.is_empty | freed))
    return replace(program, split=split)


def _redundant(matrix: FloatArray) -> BoolArray:
    """Tell which rows of matrices (n, n_rows, size) are sums of others, shape (n, n_rows)."""
    length = np.linalg.norm(matrix, axis=2, keepdims=True)
    matrix = np.divide(matrix, length, where=length > 0, out=np.zeros_like(matrix))
    used = length[:, :, 0] > 0
    with one_thread():
        gram = matrix @ matrix.transpose(0, 2, 1) + np.eye(used.shape[1]) * ~used[:, None, :]
        smallest = np.linalg.eigvalsh(gram)[:, 0]
    found = np.zeros_like(used)
    for k in np.flatnonzero(smallest < _SUSPICIOUS):
        here = np.flatnonzero(used[k])
        triangle, order = qr(matrix[k, here].T, mode="r", pivoting=True)
        left = np.zeros(here.size)
        diagonal = np.abs(np.diag(triangle))
        left[: diagonal.size] = diagonal
        found[k, here[order[left < REDUNDANT]]] = True
    return found
