"""The muscles in space, colored by activation."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from matplotlib.cm import ScalarMappable
from matplotlib.collections import LineCollection
from matplotlib.colors import Normalize
from matplotlib.figure import Figure
from matplotlib.ticker import MaxNLocator

from scso_nlp.exceptions import DataError
from scso_nlp.figures import style
from scso_nlp.trajectory import NO_POINT, Skeleton
from scso_nlp.validation import FloatArray, IntArray, read_only


def plot_muscle_lines(
    skeleton: Skeleton,
    activation: FloatArray,
    frames: Sequence[int],
    *,
    titles: Sequence[str] = (),
    highest: float | None = None,
) -> Figure:
    """Draw the muscles' lines in space, colored by activation: side view above, front view below.

    Parameters
    ----------
    skeleton : Skeleton
    activation : ndarray, shape (n_frames, n_muscles) [-]
    frames : sequence of int
        Frames to show, one column each.
    titles : sequence of str
        One per column.
    highest : float [-], optional
        Activation at the dark end of the colors; the largest shown by default.

    Returns
    -------
    matplotlib.figure.Figure
        Joints that the muscles' paths cross are black dots.

    Raises
    ------
    DataError
        Shapes do not fit, or a frame that is not there.
    """
    n_frames, n_muscles = skeleton.path_point_bodies.shape[:2]
    skeleton.require_paths()
    activation = read_only(
        "activation", activation, (n_frames, n_muscles), "n_frames, n_muscles", finite=False
    )
    frames = list(frames)
    outside = [k for k in frames if not 0 <= k < n_frames]
    if not frames or outside:
        raise DataError(f"frames to show are {frames}, expected some of 0 to {n_frames - 1}")
    if titles and len(titles) != len(frames):
        raise DataError(f"{len(titles)} titles for {len(frames)} frames, expected one each")
    if highest is None:
        highest = max(float(np.nanmax(activation[frames], initial=0.0)), 0.01)
    colors, scale = style.activation_colors(), Normalize(0.0, highest)
    moving = _crossed_joints(skeleton)
    size = (1.2 + 1.75 * len(frames), 5.2)
    figure = style.ShownFigure(figsize=size, dpi=style.RESOLUTION, layout="constrained")
    panels = figure.subplots(2, len(frames), squeeze=False)
    views = ((0, 1, "side"), (2, 1, "front"))
    shown = skeleton.path_points[frames][skeleton.path_point_bodies[frames] != NO_POINT]
    low, high = shown.min(axis=0), shown.max(axis=0)
    margin = 0.06 * float((high - low).max())
    for column, k in enumerate(frames):
        order = np.argsort(np.nan_to_num(activation[k], nan=-1.0))
        for row, (across, up, view) in enumerate(views):
            panel = panels[row, column]
            lines = []
            for m in order:
                there = skeleton.path_point_bodies[k, m] != NO_POINT
                lines.append(skeleton.path_points[k, m, there][:, [across, up]])
            collection = LineCollection(lines, cmap=colors, norm=scale, linewidths=1.8, capstyle="round")
            collection.set_array(np.ma.masked_invalid(activation[k, order]))
            panel.add_collection(collection)
            centers = skeleton.joint_centers[k, moving]
            panel.plot(centers[:, across], centers[:, up], "o", color="black", markersize=3)
            panel.set_xlim(low[across] - margin, high[across] + margin)
            panel.set_ylim(low[up] - margin, high[up] + margin)
            panel.set_aspect("equal")
            panel.xaxis.set_major_locator(MaxNLocator(3))
            panel.tick_params(labelsize=style.LEAST_TEXT, labelleft=column == 0)
            panel.spines[["top", "right"]].set_visible(False)
            if column == 0:
                panel.set_ylabel(f"{view} view, y [m]", fontsize=style.TEXT)
            panel.set_xlabel(f"{'xyz'[across]} [m]", fontsize=style.TEXT)
            if row == 0:
                style.panel_title(panel, titles[column] if titles else f"frame {k}")
    bar = figure.colorbar(ScalarMappable(norm=scale, cmap=colors), ax=panels, shrink=0.6, pad=0.02)
    bar.set_label("Activation [-]", fontsize=style.TEXT)
    bar.ax.tick_params(labelsize=style.LEAST_TEXT)
    return figure


def _crossed_joints(skeleton: Skeleton) -> IntArray:
    """Find the joints with a muscle on both sides, in the first frame."""
    bodies = skeleton.path_point_bodies[0]
    crossed = []
    for j in range(len(skeleton.joints)):
        distal = skeleton.distal_bodies(j)
        there = bodies != NO_POINT
        on_distal = there & distal[np.where(there, bodies, 0)]
        on_base = there & ~distal[np.where(there, bodies, 0)]
        if bool(np.any(on_distal.any(axis=1) & on_base.any(axis=1))):
            crossed.append(j)
    return np.array(crossed, dtype=np.int64)
