"""OpenSim files for recorded data that come without them, or with the names of files that are not there."""

from __future__ import annotations

import re
from collections.abc import Mapping
from pathlib import Path

from scso_nlp.validation import by_name

_RESERVE = """<CoordinateActuator name="{name}_reserve"><min_control>-Inf</min_control>
<max_control>Inf</max_control><coordinate>{name}</coordinate><optimal_force>{force:g}</optimal_force>
</CoordinateActuator>"""
_LOAD = """<ExternalForce name="{name}"><applied_to_body>{body}</applied_to_body>
<force_expressed_in_body>ground</force_expressed_in_body>
<point_expressed_in_body>ground</point_expressed_in_body>
<force_identifier>{name}_force_v</force_identifier><point_identifier>{name}_force_p</point_identifier>
<torque_identifier>{name}_torque_</torque_identifier></ExternalForce>"""


def reserves(model: Path, forces: Mapping[str, float]) -> str:
    """Give every coordinate of a model without couplers an unbounded actuator.

    Parameters
    ----------
    model : Path
    forces : mapping of str to float [N or N·m]
        At a control of one, by coordinate or pattern; later entries win.

    Returns
    -------
    str
        A ForceSet file.
    """
    names = re.findall(r'<Coordinate name="(.*?)"', model.read_text(encoding="utf-8"))
    sizes = by_name("coordinate", forces, names)
    return _document(
        "ForceSet", "".join(_RESERVE.format(name=n, force=f) for n, f in zip(names, sizes, strict=True))
    )


def ground_reactions(bodies: Mapping[str, str], data: Path) -> str:
    """Say which bodies the ground reactions of a file act on.

    Parameters
    ----------
    bodies : mapping of str to str
        By what the names of the columns start with, which go on as OpenSim's GUI names them.
    data : Path

    Returns
    -------
    str
        An ExternalLoads file.
    """
    loads = "".join(_LOAD.format(name=name, body=body) for name, body in bodies.items())
    return _document("ExternalLoads", loads, f"<datafile>{data.resolve()}</datafile>")


def with_data(loads: Path, data: Path) -> str:
    """Give the text of an ExternalLoads file with another data file."""
    text = loads.read_text(encoding="utf-8")
    return re.sub("<datafile>.*?</datafile>", lambda _: f"<datafile>{data.resolve()}</datafile>", text)


def _document(kind: str, objects: str, rest: str = "") -> str:
    return (
        '<?xml version="1.0" encoding="UTF-8"?><OpenSimDocument Version="40600">'
        f'<{kind} name="made"><objects>{objects}</objects>{rest}</{kind}></OpenSimDocument>'
    )
