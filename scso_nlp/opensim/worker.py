"""One OpenSim process: model and motion in, arrays out.

Run as a script by :mod:`scso_nlp.opensim.engine`, never imported: the one file that imports ``opensim``,
and it needs nothing else but NumPy. It reads a job (JSON), works through its share of the frames, writes the
arrays to an ``.npz`` file and tells its parent how far it is, one JSON object per line on standard output.
OpenSim's own messages go to a log file beside the job.

The recipe: no analysis tools. Moment arms come from each path's equivalent body
forces through the transposed system Jacobian, net generalized forces from OpenSim's inverse dynamics, both
reduced to the free coordinates with du/du_free from the constraint matrix. Only second derivatives of path
lengths are central differences, of these moment arms.
"""

from __future__ import annotations

import contextlib
import json
import os
import re
import sys
import time as clock
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from typing import Any, TextIO

import numpy as np
from numpy.typing import NDArray

#: Largest constraint error of a pose that needs no assembling [m] or [rad]. OpenSim's own accuracy is 1e-10.
POSE_TOLERANCE = 1e-9
#: A mobility whose elimination leaves more than this of a constraint row was a wrong choice [-].
ELIMINATION_TOLERANCE = 1e-6
#: Smallest pivot, relative to the largest, that counts as an independent constraint [-].
RANK_TOLERANCE = 1e-8
#: Coordinates without a column may rest at zero if they move no more than this share of the total mass [-].
LIGHT_SEGMENT = 0.01
#: Speeds belong to a row of coordinates if their times differ by no more than this [s].
SAME_TIME = 1e-6
#: Half step of the virtual rotations about joint axes [rad]: rounding and truncation errors meet near it.
VIRTUAL_STEP = 1e-4
#: Half step of the derivatives along coordinates [rad or m], for points fixed to bodies and for loads.
FINE_STEP = 2e-5
#: For paths that wrap, move or follow splines: half step, a wider one that must agree with it, and one that
#: spans the artefacts where they do not.
STEP, WIDE_STEP, WIDEST_STEP = 1e-4, 1e-3, 1e-2
#: Derivatives of moment arms agree if they differ by no more than this [m], or this share of the larger.
SAME_SLOPE, SAME_SLOPE_SHARE = 1e-4, 1e-2
#: Largest constraint error at the points of the stencil [m] or [rad], and most Newton steps to get there.
LOOP_TOLERANCE, LOOP_ITERATIONS = 1e-13, 8
#: Joints that move bodies along straight lines and circles only.
SMOOTH_JOINTS = (
    "PinJoint",
    "SliderJoint",
    "UniversalJoint",
    "GimbalJoint",
    "PlanarJoint",
    "FreeJoint",
)
#: Seconds between two progress messages.
PROGRESS_INTERVAL = 0.1

#: Scalar properties of a muscle that shape its curves, for whichever class has them.
CURVE_PROPERTIES = (
    "FmaxTendonStrain",
    "FmaxMuscleStrain",
    "KshapeActive",
    "KshapePassive",
    "Af",
    "Flen",
    "fv_linear_extrap_threshold",
    "fiber_damping",
    "active_force_width_scale",
    "passive_fiber_strain_at_one_norm_force",
    "tendon_strain_at_one_norm_force",
    "ignore_passive_fiber_force",
    "ignore_tendon_compliance",
    "maximum_pennation_angle",
    "default_activation",
    "minimum_activation",
)
#: Curve objects of a Millard muscle: prefix of the keys and the method that returns the curve.
CURVE_OBJECTS = {
    "active_force_length_curve": "getActiveForceLengthCurve",
    "force_velocity_curve": "getForceVelocityCurve",
    "fiber_force_length_curve": "getFiberForceLengthCurve",
    "tendon_force_length_curve": "getTendonForceLengthCurve",
}
#: Splines of a RigidTendonMuscle; their points become ``<property>.x<i>`` and ``<property>.y<i>``.
SPLINES = ("active_force_length_curve", "passive_force_length_curve", "force_velocity_curve")
#: Values that OpenSim chooses itself where the optional property is empty.
CURVE_VALUES_IN_USE = {
    "stiffness_at_low_force": "getStiffnessAtLowForceInUse",
    "stiffness_at_one_norm_force": "getStiffnessAtOneNormForceInUse",
    "norm_force_at_toe_end": "getNormForceAtToeEndInUse",
    "curviness": "getCurvinessInUse",
}

Array = NDArray[np.float64]


class Refusal(Exception):
    """Input that cannot be used; `kind` is the exception the parent raises."""

    def __init__(self, message: str, kind: str = "DataError") -> None:
        super().__init__(message)
        self.kind = kind


# ----------------------------------------------------------------------------------------------- process


def main() -> int:
    """Do the job named on the command line."""
    with open(sys.argv[1], encoding="utf-8") as file:
        job: dict[str, Any] = json.load(file)
    parent = _talk_to_parent_only(job["log"])
    try:
        arrays = extract(job, parent)
        with open(job["output"], "wb") as target:
            np.savez(target, **arrays)
        _tell(parent, done=True)
    except Refusal as refusal:
        _tell(parent, error=refusal.kind, message=str(refusal))
        return 2
    except RuntimeError as error:
        _tell(parent, error="EngineError", message=_plain(str(error), job))
        return 3
    finally:
        sys.stdout.flush()
        parent.flush()
    return 0


def _talk_to_parent_only(log: str) -> TextIO:
    """Keep the pipe to the parent for messages; whatever else is printed goes to the log file."""
    parent = os.fdopen(os.dup(1), "w", encoding="utf-8")
    sys.stdout.flush()
    descriptor = os.open(log, os.O_WRONLY | os.O_CREAT | os.O_APPEND, 0o600)
    for standard in (1, 2):
        os.dup2(descriptor, standard)
    os.close(descriptor)
    return parent


def _tell(parent: TextIO, **message: object) -> None:
    parent.write(json.dumps(message) + "\n")
    parent.flush()


def _plain(message: str, job: dict[str, Any]) -> str:
    """Turn an exception text of OpenSim into one sentence."""
    text = re.sub(r"^std::exception in '.*?': ", "", message.strip(), flags=re.DOTALL)
    text = re.sub(r"\s*Thrown at [^\n]*", "", text)
    text = re.sub(r"\(details: (.*?)\)\.?", r"(\1)", text, flags=re.DOTALL)
    text = re.sub(r"\.?\s*\n\s*In (Component|Object) ", r", in \1 ", text)
    text = " ".join(text.split()).rstrip(".")
    text = re.sub(r"\.\)", ")", text)
    text = re.sub(r"\.\s*\(", " (", text)
    name = os.path.basename(job["motion"]["model"])
    return f"OpenSim refused {name}: {text or 'no reason given'}"


def extract(job: dict[str, Any], parent: TextIO) -> dict[str, Any]:
    """Compute every array of the job's share of the frames.

    Parameters
    ----------
    job : dict
        ``motion`` (the fields of `MotionInput`), ``data`` (an ``.npz`` of the motion files as read by the
        parent), ``part`` and ``parts`` (this worker's share), ``output``, ``log``.
    parent : file
        Where to write progress.

    Returns
    -------
    dict of str to ndarray
        Arrays by field name; ``header`` holds names and constants as JSON.
    """
    started = clock.perf_counter()
    with contextlib.redirect_stdout(sys.stderr):
        import opensim

    opensim.Logger.setLevelString("Info")
    engine = Engine(opensim, job["motion"])
    motion = Motion(engine, job)
    rows = np.array_split(motion.rows, job["parts"])[job["part"]]
    engine.choose_free_coordinates(motion, int(motion.rows[0]))
    virtual = VirtualRotations(engine, job["motion"]) if job["motion"]["stability_axes"] else None
    chosen = job["motion"]["curvature_coordinates"]
    derivatives = CoordinateDerivatives(engine, chosen) if chosen else None
    startup = clock.perf_counter() - started
    _tell(parent, total=len(motion.rows), share=len(rows), startup=startup)

    began = clock.perf_counter()
    told = began
    frames: list[dict[str, Array]] = []
    for count, row in enumerate(rows, start=1):
        frame = engine.frame(motion, int(row))
        if virtual is not None:
            frame.update(virtual.frame(frame, engine.poses))
        if derivatives is not None:
            frame.update(derivatives.frame(frame))
        frames.append(frame)
        if clock.perf_counter() - told > PROGRESS_INTERVAL or count == len(rows):
            told = clock.perf_counter()
            _tell(parent, frames=count)
    if not frames:
        return {}
    n_points = max(frame["path_point_bodies"].shape[1] for frame in frames)
    for frame in frames:
        _pad_points(frame, n_points)
    # one array at a time leaves the frames: all together would be in memory twice
    arrays: dict[str, Any] = {
        name: np.stack([frame.pop(name) for frame in frames]) for name in list(frames[0])
    }
    header = engine.header() | {
        "notes": motion.notes + engine.notes,
        "contradicted_speeds": engine.contradicted,
        "virtual_rows": virtual.names if virtual is not None else [],
        "curvature_coordinates": derivatives.names if derivatives is not None else [],
        "uncertain_frames": derivatives.uncertain.tolist() if derivatives is not None else [],
        "seconds": {"startup": startup, "frames": clock.perf_counter() - began},
        "peak_memory": _peak_memory(),
        "opensim_version": opensim.GetVersion(),
    }
    arrays["header"] = np.frombuffer(json.dumps(header).encode("utf-8"), dtype=np.uint8)
    return arrays


def _pad_points(frame: dict[str, Array], n_points: int) -> None:
    for name, fill in (("path_points", 0.0), ("path_point_bodies", -1), ("path_point_moves", False)):
        array = frame[name]
        padded = np.full((array.shape[0], n_points, *array.shape[2:]), fill, dtype=array.dtype)
        padded[:, : array.shape[1]] = array
        frame[name] = padded


def _peak_memory() -> int:
    """Return the largest resident memory so far [bytes], 0 where the system does not tell."""
    try:
        import resource
    except ImportError:
        return 0
    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss * 1024


# ------------------------------------------------------------------------------------------------ motion


class Motion:
    """Coordinates, speeds and accelerations of every row, prepared as OpenSim's AnalyzeTool does.

    Attributes
    ----------
    time : ndarray, shape (n_rows,) [s]
    values, speeds : ndarray, shape (n_rows, n_u) [rad or m], [rad/s or m/s]
        In tree order; rows include the padding of the low-pass filter.
    accelerations : ndarray, shape (n_rows, n_u)
        Derivative of the quintic spline through the speeds; filled for `rows` only.
    rows : ndarray of int
        The rows to analyze.
    """

    def __init__(self, engine: Engine, job: dict[str, Any]) -> None:
        osim, given = engine.osim, job["motion"]
        self.notes: list[list[str]] = []
        self.keeps_coupled_speeds = bool(given["keep_coupled_speeds"])
        source = given["states"] or given["coordinates"]
        data = np.load(job["data"], allow_pickle=False)
        labels = json.loads(bytes(data["labels"]).decode("utf-8"))
        unusable: dict[str, str] = json.loads(bytes(data["unusable"]).decode("utf-8"))
        storage = _storage(osim, labels, data["time"], data["values"])
        cutoff = given["lowpass_cutoff_frequency"]
        if given["states"] is None and cutoff is not None and cutoff >= 0:
            storage.pad(storage.getSize() // 2)
            storage.lowpassIIR(cutoff)
        columns = self._columns(engine, storage, labels, unusable, given, source)
        self.time = _time(osim, storage)
        self.values = np.zeros((len(self.time), engine.n_u))
        for k, column in enumerate(columns):
            if column >= 0:
                self.values[:, k] = _column(osim, storage, column)
        if given["in_degrees"]:
            self.values[:, engine.scales_with_degrees] *= np.pi / 180.0
        self.rows = _selected_rows(self.time, given, data["time"])
        self.speeds = self._speeds(engine, storage, data, given)
        splines = _splines(osim, engine.coordinate_names, self.time, self.speeds)
        self.accelerations = np.full_like(self.speeds, np.nan)
        for row in self.rows:
            t = float(self.time[row])
            self.accelerations[row] = [splines.evaluate(k, 1, t) for k in range(engine.n_u)]

    def _columns(
        self,
        engine: Engine,
        storage: Any,
        labels: list[str],
        unusable: dict[str, str],
        given: dict[str, Any],
        source: str,
    ) -> list[int]:
        columns = []
        missing: list[str] = []
        for k, coordinate in enumerate(engine.coordinates):
            column = int(storage.getStateIndex(coordinate.getName()))
            if column < 0:
                column = int(storage.getStateIndex(coordinate.getAbsolutePathString() + "/value"))
            if column >= 0 and labels[column] in unusable:
                raise Refusal(
                    f"{source}: column {labels[column]!r} is {unusable[labels[column]]}, expected a finite "
                    f"number (coordinate {coordinate.getName()!r})"
                )
            columns.append(column)
            if column >= 0 or engine.is_set_by_model[k]:
                continue
            missing.append(coordinate.getName())
        held = set(given["held_coordinates"])
        refused: list[str] = []
        for name in missing:
            share = engine.moved_mass(name)
            if name in held:
                self.notes.append(["INFO", f"{source} has no column for {name!r}: held at zero as asked"])
            elif share <= LIGHT_SEGMENT:
                self.notes.append(
                    [
                        "WARNING",
                        f"{source} has no column for the coordinate {name!r}: held at zero, as OpenSim does "
                        f"(it moves {100 * share:.2g} % of the model's mass)",
                    ]
                )
            else:
                refused.append(name)
        if refused:
            raise Refusal(
                f"{source} has no column for {', '.join(refused)}, coordinates of "
                f"{os.path.basename(given['model'])} (OpenSim would hold them at zero; if that is "
                "meant, name them in held_coordinates)",
                "NameMismatchError",
            )
        return columns

    def _speeds(self, engine: Engine, storage: Any, data: Any, given: dict[str, Any]) -> Array:
        osim = engine.osim
        if given["states"] is not None:
            speeds = np.zeros_like(self.values)
            for k, coordinate in enumerate(engine.coordinates):
                column = int(storage.getStateIndex(coordinate.getAbsolutePathString() + "/speed"))
                if column < 0:
                    column = int(storage.getStateIndex(coordinate.getName() + "_u"))
                if column >= 0:
                    speeds[:, k] = _column(osim, storage, column)
                elif not engine.is_set_by_model[k]:
                    raise Refusal(
                        f"{given['states']} has no column for the speed of {coordinate.getName()!r}, "
                        f"expected {coordinate.getAbsolutePathString()}/speed",
                        "NameMismatchError",
                    )
            return speeds
        splines = _splines(osim, engine.coordinate_names, self.time, self.values)
        derivative = splines.constructStorage(1)
        speeds = np.stack([_column(osim, derivative, k) for k in range(engine.n_u)], axis=1)
        if given["speeds"] is None:
            return speeds
        given_labels = json.loads(bytes(data["speed_labels"]).decode("utf-8"))
        given_time = data["speed_time"]
        nearest = np.abs(given_time[None, :] - self.time[:, None]).argmin(axis=1)
        apart = np.abs(given_time[nearest] - self.time)
        if (apart[self.rows] > SAME_TIME).any():
            row = self.rows[int(apart[self.rows].argmax())]
            raise Refusal(
                f"{given['speeds']} has no row at t = {self.time[row]:.9g} s, expected the times of the "
                "coordinates"
            )
        table = _storage(osim, given_labels, given_time, data["speed_values"])
        for k, coordinate in enumerate(engine.coordinates):
            name = coordinate.getName()
            path = coordinate.getAbsolutePathString()
            found = [int(table.getStateIndex(label)) for label in (path + "/speed", name + "_u", name)]
            column = next((column for column in found if column >= 0), -1)
            if column >= 0:
                speeds[:, k] = data["speed_values"][nearest, column]
            elif not engine.is_set_by_model[k]:
                raise Refusal(f"{given['speeds']} has no column for {name!r}", "NameMismatchError")
        return speeds


def _selected_rows(time: Array, given: dict[str, Any], recorded: Array) -> NDArray[np.int64]:
    """Choose rows as AnalyzeTool does: the last row at or before each end, no interpolation.

    `time` may reach beyond the time that was `recorded`, for the filter's sake.
    """
    ends = (
        recorded[0] if given["initial_time"] is None else given["initial_time"],
        recorded[-1] if given["final_time"] is None else given["final_time"],
    )
    first, last = (max(int(np.searchsorted(time, end, side="right")) - 1, 0) for end in ends)
    step = given["step_interval"]
    rows = [row for row in range(first, last + 1) if row in (first, last) or row % step == 0]
    return np.array(rows, dtype=np.int64)


def _storage(osim: Any, labels: list[str], time: Array, values: Array) -> Any:
    storage = osim.Storage()
    names = osim.ArrayStr()
    for label in ("time", *labels):
        names.append(label)
    storage.setColumnLabels(names)
    for t, row in zip(time.tolist(), np.ascontiguousarray(values), strict=True):
        storage.append(t, osim.Vector.createFromMat(row))
    return storage


def _splines(osim: Any, names: list[str], time: Array, values: Array) -> Any:
    return osim.GCVSplineSet(5, _storage(osim, names, time, values))


def _column(osim: Any, storage: Any, index: int) -> Array:
    column = osim.ArrayDouble()
    storage.getDataColumn(index, column)
    return np.array(column.getAsVector().to_numpy())


def _time(osim: Any, storage: Any) -> Array:
    column = osim.ArrayDouble()
    storage.getTimeColumn(column)
    return np.array(column.getAsVector().to_numpy())


# ------------------------------------------------------------------------------------------------- model


class Engine:
    """The model, its state, and everything that is computed from one pose."""

    def __init__(self, osim: Any, given: dict[str, Any]) -> None:
        self.osim = osim
        self.notes: list[list[str]] = []
        #: by how much the motion's speeds of dependent coordinates contradict the constraints, at most
        self.contradicted: dict[str, float] = {}
        self.model, self._tool = _load_model(osim, given)
        self.state = self.model.initSystem()
        self.model.setAllControllersEnabled(False)
        self.model.realizeVelocity(self.state)
        self.matter = self.model.getMatterSubsystem()
        self.n_u = int(self.state.getNU())
        self._find_coordinates()
        self._find_forces()
        self._without_passives = self._state_without_passives()
        self.model.realizeVelocity(self.state)
        self._find_bodies()
        self._find_joints()
        self._find_paths()
        self.dependent = np.zeros(self.n_u, dtype=bool)
        self.free = np.arange(self.n_u)
        self._solver = osim.InverseDynamicsSolver(self.model)
        self._matrix, self._vector = osim.Matrix(), osim.Vector()
        n_bodies = self._system_jacobian().shape[0] // 6
        self._no_body_forces = osim.VectorOfSpatialVec(n_bodies, osim.SpatialVec(osim.Vec3(0), osim.Vec3(0)))
        self._no_mobility_forces = osim.Vector(self.n_u, 0.0)

    # -- inventory

    def _find_coordinates(self) -> None:
        osim = self.osim
        by_path = {}
        coordinates = self.model.getCoordinateSet()
        for i in range(coordinates.getSize()):
            by_path[coordinates.get(i).getAbsolutePathString()] = coordinates.get(i)
        names = osim.createStateVariableNamesInSystemOrder(self.model)
        self.coordinates = [by_path[name.removesuffix("/value")] for name in names if name.endswith("/value")]
        if len(self.coordinates) != self.n_u:
            raise Refusal(
                f"the model has {self.n_u} mobilities but {len(self.coordinates)} coordinates, "
                "expected as many",
                "EngineError",
            )
        self.coordinate_names = [coordinate.getName() for coordinate in self.coordinates]
        rotational = [int(coordinate.getMotionType()) for coordinate in self.coordinates]
        self.scales_with_degrees = np.array([kind == 1 for kind in rotational])
        self.is_rotational = np.array([kind != 2 for kind in rotational])
        state = self.state
        self.is_locked = np.array([coordinate.getLocked(state) for coordinate in self.coordinates])
        self.is_prescribed = np.array([coordinate.isPrescribed(state) for coordinate in self.coordinates])
        self.is_set_by_model = np.array([coordinate.isConstrained(state) for coordinate in self.coordinates])
        self.couplers = []
        constraints = self.model.getConstraintSet()
        for i in range(constraints.getSize()):
            coupler = osim.CoordinateCouplerConstraint.safeDownCast(constraints.get(i))
            if coupler is None or not coupler.isEnforced(state):
                continue
            independent = coupler.getIndependentCoordinateNames()
            where = [self.coordinate_names.index(independent.get(j)) for j in range(independent.getSize())]
            target = self.coordinate_names.index(coupler.getDependentCoordinateName())
            scale = osim.PropertyHelper.getValueDouble(coupler.getPropertyByName("scale_factor"))
            self.couplers.append((target, where, coupler.getFunction(), scale))
        self.is_constrained = len(state.getUErr().to_numpy()) > 0

    def _find_forces(self) -> None:
        osim = self.osim
        self.muscles: list[Any] = []
        self.actuators: list[Any] = []
        self.loads: list[Any] = []
        self.passives: list[Any] = []
        self._recorded: list[Any] = []
        self.force_columns: list[str] = []
        self.other_labels: list[str] = []
        not_scalar, dropped = [], []
        for force in _forces(osim, self.model):
            active = bool(force.appliesForce(self.state))
            muscle = osim.Muscle.safeDownCast(force)
            scalar = osim.ScalarActuator.safeDownCast(force)
            actuator = osim.Actuator.safeDownCast(force)
            load = osim.ExternalForce.safeDownCast(force)
            if actuator is not None:
                if scalar is not None and muscle is None:
                    scalar.overrideActuation(self.state, True)
                    scalar.setOverrideActuation(self.state, 0.0)
                else:
                    force.setAppliesForce(self.state, False)
                if not active:
                    dropped.append(force.getName())
                elif scalar is None:
                    not_scalar.append(f"{force.getName()} ({force.getConcreteClassName()})")
                elif muscle is not None:
                    self.muscles.append(muscle)
                else:
                    self.actuators.append(scalar)
                if active:
                    self.force_columns.append(force.getName())
                continue
            if not active:
                continue
            if load is not None:
                self.loads.append(load)
            else:
                self.passives.append(force)
            record = force.getRecordLabels()
            labels = [record.get(i) for i in range(record.getSize())]
            # OpenSim repeats labels, e.g. PotentialEnergy of limit forces: later ones get their owner's name
            labels = [f"{force.getName()}.{x}" if x in self.other_labels else x for x in labels]
            self._recorded.append((force, len(labels)))
            self.other_labels += labels
            self.force_columns += labels
        if not_scalar:
            raise Refusal(
                f"the actuator {not_scalar[0]} is not a scalar actuator, which OpenSim's static optimization "
                "refuses too"
            )
        if dropped:
            self.notes.append(["INFO", f"switched off in the model and left out: {', '.join(dropped)}"])
        if not self.muscles:
            raise Refusal("the model has no muscle that applies force, expected at least one")
        self.muscle_names = [muscle.getName() for muscle in self.muscles]
        self.actuator_names = [actuator.getName() for actuator in self.actuators]
        self._constant_columns: dict[int, tuple[int, float]] = {}
        for j, actuator in enumerate(self.actuators):
            plain = osim.CoordinateActuator.safeDownCast(actuator)
            if plain is not None and plain.getConcreteClassName() == "CoordinateActuator":
                coordinate = plain.getCoordinate().getName()
                self._constant_columns[j] = (
                    self.coordinate_names.index(coordinate),
                    float(plain.getOptimalForce()),
                )

    def _state_without_passives(self) -> Any:
        if not self.passives:
            return None
        state = self.osim.State(self.state)
        for force in self.passives:
            force.setAppliesForce(state, False)
        return state

    def _find_bodies(self) -> None:
        bodies = self.model.getBodySet()
        self.bodies = [bodies.get(i) for i in range(bodies.getSize())]
        self._body_index = {int(self.model.getGround().getMobilizedBodyIndex()): 0}
        for b, body in enumerate(self.bodies, start=1):
            self._body_index[int(body.getMobilizedBodyIndex())] = b
        self._mobilized = np.array(
            [int(body.getMobilizedBodyIndex()) for body in self.bodies], dtype=np.int64
        )
        self.body_names = ["ground", *(body.getName() for body in self.bodies)]
        self.body_masses = np.array([0.0, *(float(body.getMass()) for body in self.bodies)])
        centers = [body.getMassCenter().to_numpy() for body in self.bodies]
        self.mass_centers = np.array([np.zeros(3), *centers])
        self.body_parents = np.full(len(self.body_names), -1, dtype=np.int64)
        vec3 = self.osim.Vec3
        self._frame_points = (vec3(0), vec3(1, 0, 0), vec3(0, 1, 0), vec3(0, 0, 1))

    def _find_joints(self) -> None:
        osim = self.osim
        joints = self.model.getJointSet()
        self.joints: list[Any] = []
        self.joint_parents: list[int] = []
        self.joint_children: list[int] = []
        self._rotation_functions: list[list[Any] | None] = []
        nominal, orders, signs = [], [], []
        for i in range(joints.getSize()):
            joint = joints.get(i)
            parent, child = self.base_body(joint.getParentFrame()), self.base_body(joint.getChildFrame())
            self.body_parents[child] = parent
            if joint.numCoordinates() == 0:
                continue
            self.joints.append(joint)
            self.joint_parents.append(parent)
            self.joint_children.append(child)
            custom = osim.CustomJoint.safeDownCast(joint)
            functions, axes, order, sign = None, np.eye(3), [0, 1, 2], np.ones(3)
            if custom is not None:
                functions, axes, order, sign = self._rotation_axes(custom)
            self._rotation_functions.append(functions)
            nominal.append(axes)
            orders.append(order)
            signs.append(sign)
        self.joint_names = [joint.getName() for joint in self.joints]
        # per joint: its successive axes in the parent frame, and which of them is called x, y, z
        self._nominal_axes = np.array(nominal).reshape(-1, 3, 3)
        self._axis_orders = np.array(orders, dtype=np.int64).reshape(-1, 3)
        self._axis_signs = np.array(signs).reshape(-1, 3)
        self._parent_frames = self._offsets([joint.getParentFrame() for joint in self.joints])
        self._child_frames = self._offsets([joint.getChildFrame() for joint in self.joints])

    def _offsets(self, frames: list[Any]) -> tuple[NDArray[np.int64], Array, Array]:
        """Return the body of each frame, and its rotation and origin in that body."""
        bodies = np.array([self.base_body(frame) for frame in frames], dtype=np.int64)
        rotations, origins = np.zeros((len(frames), 3, 3)), np.zeros((len(frames), 3))
        for i, frame in enumerate(frames):
            base = frame.findBaseFrame()
            points = [
                frame.findStationLocationInAnotherFrame(self.state, point, base).to_numpy()
                for point in self._frame_points
            ]
            origins[i] = points[0]
            rotations[i] = np.stack([point - origins[i] for point in points[1:]], axis=1)
        return bodies, rotations, origins

    def _rotation_axes(self, joint: Any) -> tuple[list[Any], Array, list[int], Array]:
        """Return the rotational transform axes, their directions, and which letter each one gets."""
        transform = joint.getSpatialTransform()
        functions = [transform.getTransformAxis(i) for i in range(3)]
        axes = np.array([_unit(function.getAxis().to_numpy()) for function in functions])
        orders = ((0, 1, 2), (0, 2, 1), (1, 0, 2), (1, 2, 0), (2, 0, 1), (2, 1, 0))
        nearest = max(orders, key=lambda order: sum(abs(axes[order[u], u]) for u in range(3)))
        signs = np.array([-1.0 if axes[nearest[u], u] < 0 else 1.0 for u in range(3)])
        return functions, axes, list(nearest), signs

    def _find_paths(self) -> None:
        """Sort paths into those of points fixed to bodies and those whose points change."""
        osim = self.osim
        self._paths = [muscle.getPath() for muscle in self.muscles]
        self.geometry = [osim.GeometryPath.safeDownCast(path) for path in self._paths]
        self.fixed_points: list[tuple[NDArray[np.int64], Array] | None] = []
        self.moves: list[bool] = []
        self._drives_mobilities: list[bool] = []
        for geometry in self.geometry:
            if geometry is None:
                self._drives_mobilities.append(True)
                self.fixed_points.append((np.zeros(0, dtype=np.int64), np.zeros((0, 3))))
                self.moves.append(True)
                continue
            points = geometry.getPathPointSet()
            kinds = [points.get(i).getConcreteClassName() for i in range(points.getSize())]
            wraps = geometry.getWrapSet().getSize() > 0
            self._drives_mobilities.append(any(kind == "MovingPathPoint" for kind in kinds))
            self.moves.append(wraps or any(kind != "PathPoint" for kind in kinds))
            if self.moves[-1]:
                self.fixed_points.append(None)
                continue
            ends, locations = [], []
            for i in range(points.getSize()):
                body, location = self._point_in_body(points.get(i))
                ends.append(body)
                locations.append(location)
            self.fixed_points.append((np.array(ends, dtype=np.int64), np.array(locations)))

    def _point_in_body(self, point: Any) -> tuple[int, Array]:
        frame = point.getParentFrame()
        base = frame.findBaseFrame()
        location = point.getLocation(self.state)
        if frame.getAbsolutePathString() != base.getAbsolutePathString():
            location = frame.findStationLocationInAnotherFrame(self.state, location, base)
        return self.base_body(frame), np.array(location.to_numpy())

    def base_body(self, frame: Any) -> int:
        """Index of the body that a physical frame is fixed to."""
        return self._body_index[int(frame.getMobilizedBodyIndex())]

    def distal_bodies(self, child: int) -> set[int]:
        """Return the bodies that hang on a body, itself included."""
        distal = {child}
        for _ in self.body_names:
            distal |= {b for b, parent in enumerate(self.body_parents) if parent in distal}
        return distal

    def child_of_coordinate(self, k: int) -> int:
        """Return the body on the distal side of a coordinate's joint."""
        return self.base_body(self.coordinates[k].getJoint().getChildFrame())

    def path_bodies(self, m: int) -> set[int]:
        """Return every body that a muscle's path may touch."""
        points, wraps = self.geometry[m].getPathPointSet(), self.geometry[m].getWrapSet()
        bodies = {self.base_body(points.get(i).getParentFrame()) for i in range(points.getSize())}
        for i in range(wraps.getSize()):
            bodies.add(self.base_body(wraps.get(i).getWrapObject().getFrame()))
        return bodies

    def moved_mass(self, coordinate: str) -> float:
        """Share of the total mass on the distal side of a coordinate's joint; 1 if a load acts there."""
        distal = self.distal_bodies(self.child_of_coordinate(self.coordinate_names.index(coordinate)))
        if any(self.load_body(load) in distal for load in self.loads):
            return 1.0
        return float(self.body_masses[sorted(distal)].sum() / max(self.body_masses.sum(), 1e-300))

    def load_body(self, load: Any) -> int:
        """Return the index of the body that an external load acts on."""
        frame = self.osim.PhysicalFrame.safeDownCast(self._physical_frame(load.getAppliedToBodyName()))
        return self.base_body(frame)

    def _physical_frame(self, name: str) -> Any:
        if name in ("ground", "/ground"):
            return self.model.getGround()
        path = name if name.startswith("/") else f"/bodyset/{name}"
        return self.model.getComponent(path)

    # -- reduction

    def choose_free_coordinates(self, motion: Motion, row: int) -> None:
        """Choose once which coordinates are eliminated, the same in every worker and frame.

        Locked, prescribed and coupled coordinates first; closed loops (point constraints) then give up one
        coordinate per remaining independent constraint, the one that the constraints determine best.
        """
        self.pose(motion, row)
        if not self.is_constrained:
            return
        constraints = self.constraint_matrix(self.state)
        dependent = self.is_set_by_model.copy()
        scale = np.abs(constraints).max(initial=0.0)
        rest = constraints.copy()
        # clear what the coordinates set by the model account for, by orthogonal projection of the rows
        basis, values, _ = np.linalg.svd(constraints[:, dependent], full_matrices=True)
        rank = int((values > RANK_TOLERANCE * max(scale, 1e-300)).sum())
        rest = basis[:, rank:].T @ constraints
        rest[:, dependent] = 0.0
        while rest.size and np.abs(rest).max() > RANK_TOLERANCE * scale:
            norms = np.linalg.norm(rest, axis=0)
            best = int(norms.argmax())
            direction = rest[:, best] / norms[best]
            rest = rest - np.outer(direction, direction @ rest)
            rest[:, best] = 0.0
            dependent[best] = True
        self.dependent = dependent
        self.free = np.flatnonzero(~dependent)
        names = [name for name, gone in zip(self.coordinate_names, dependent, strict=True) if gone]
        loops = [name for name in names if not self.is_set_by_model[self.coordinate_names.index(name)]]
        self.notes.append(["INFO", f"coordinates eliminated by the model's constraints: {', '.join(names)}"])
        if loops:
            self.notes.append(["INFO", f"of these, chosen to close loops: {', '.join(loops)}"])

    def constraint_matrix(self, state: Any) -> Array:
        """Return the velocity constraints' matrix, shape (n_constraints, n_u)."""
        self.matter.calcG(state, self._matrix)
        return np.array(self._matrix.to_numpy()).reshape(-1, self.n_u)

    def _system_jacobian(self) -> Array:
        matrix = self.osim.Matrix()
        self.matter.calcSystemJacobian(self.state, matrix)
        return np.array(matrix.to_numpy())

    def coupling(self, constraints: Array) -> Array:
        """Return du/du_free, shape (n_u, n_free)."""
        coupling = np.zeros((self.n_u, len(self.free)))
        coupling[self.free, np.arange(len(self.free))] = 1.0
        if self.dependent.any():
            own, others = constraints[:, self.dependent], constraints[:, ~self.dependent]
            coupling[self.dependent] = -np.linalg.lstsq(own, others, rcond=RANK_TOLERANCE)[0]
            left = np.abs(constraints @ coupling).max(initial=0.0)
            if left > ELIMINATION_TOLERANCE * max(np.abs(constraints).max(initial=0.0), 1e-300):
                raise Refusal(
                    "the coordinates chosen to close the model's loops do not determine it at "
                    f"t = {self.state.getTime():.9g} s: its constraints are singular there",
                    "EngineError",
                )
        return coupling

    # -- pose

    def pose(self, motion: Motion, row: int) -> None:
        """Put the model into a row of the motion, constraints satisfied, realized to velocity."""
        state, vector = self.state, self.osim.Vector
        time = float(motion.time[row])
        state.setTime(time)
        values, speeds = motion.values[row].copy(), motion.speeds[row].copy()
        for k in np.flatnonzero(self.is_prescribed).tolist():
            function = self.coordinates[k].getPrescribedFunction()
            values[k] = function.calcValue(vector(1, time))
        for k in np.flatnonzero(self.is_locked).tolist():
            values[k] = self.coordinates[k].getValue(state)
        self.follow(values)
        for k, coordinate in enumerate(self.coordinates):
            if not self.is_locked[k]:
                coordinate.setValue(state, float(values[k]), False)
                coordinate.setSpeedValue(state, float(speeds[k]))
        self.model.realizePosition(state)
        if self.is_constrained:
            if np.abs(state.getQErr().to_numpy()).max(initial=0.0) > POSE_TOLERANCE:
                self.model.assemble(state)
            self._check_coupled_speeds(keep=motion.keeps_coupled_speeds)
        self.model.realizeVelocity(state)

    def follow(self, values: Array) -> None:
        """Give coupled coordinates the values that their couplers ask for, in place."""
        for _ in range(min(len(self.couplers), 4)):
            for target, where, function, scale in self.couplers:
                argument = self.osim.Vector.createFromMat(np.ascontiguousarray(values[where]))
                values[target] = scale * function.calcValue(argument)

    def close_loops(self, state: Any) -> None:
        """Move the dependent coordinates until the constraints hold; the free ones stay."""
        for _ in range(LOOP_ITERATIONS):
            error = np.array(state.getQErr().to_numpy())
            if np.abs(error).max(initial=0.0) <= LOOP_TOLERANCE:
                return
            own = self.constraint_matrix(state)[: len(error), self.dependent]
            change = -np.linalg.lstsq(own, error, rcond=RANK_TOLERANCE)[0]
            for k, dq in zip(np.flatnonzero(self.dependent), change, strict=True):
                if not self.is_locked[k]:
                    coordinate = self.coordinates[k]
                    coordinate.setValue(state, float(coordinate.getValue(state) + dq), False)
            self.model.realizePosition(state)
        if np.abs(np.array(state.getQErr().to_numpy())).max(initial=0.0) > POSE_TOLERANCE:
            raise Refusal(
                f"the model's constraints cannot be kept near its pose at t = {state.getTime():.9g} s",
                "EngineError",
            )

    def _check_coupled_speeds(self, *, keep: bool) -> None:
        """Note where dependent coordinates have other speeds than constraints imply, or correct them."""
        if not self.dependent.any():
            return
        state = self.state
        self.model.realizeVelocity(state)
        error = np.array(state.getUErr().to_numpy())
        own = self.constraint_matrix(self.state)[:, self.dependent]
        change = -np.linalg.lstsq(own, error, rcond=RANK_TOLERANCE)[0]
        for k, du in zip(np.flatnonzero(self.dependent), change, strict=True):
            coordinate = self.coordinates[k]
            if not self.is_locked[k]:
                if not keep:
                    coordinate.setSpeedValue(state, float(coordinate.getSpeedValue(state) + du))
                name = self.coordinate_names[k]
                self.contradicted[name] = max(self.contradicted.get(name, 0.0), abs(float(du)))

    # -- one frame

    def frame(self, motion: Motion, row: int) -> dict[str, Array]:
        """Compute everything that belongs to one row of the motion."""
        self.pose(motion, row)
        state = self.state
        constraints = self.constraint_matrix(self.state) if self.is_constrained else np.zeros((0, self.n_u))
        coupling = self.coupling(constraints)
        accelerations = self._accelerations(motion.accelerations[row], constraints)
        self.poses = self.body_poses(self.state)
        net = self.inverse_dynamics(accelerations)
        result = {
            "time": np.array(motion.time[row]),
            "coordinate_values": self._read("getValue"),
            "coordinate_speeds": self._read("getSpeedValue"),
            "muscle_tendon_length": np.array([path.getLength(state) for path in self._paths]),
            "muscle_tendon_velocity": np.array([path.getLengtheningSpeed(state) for path in self._paths]),
            "moment_arms": coupling.T @ self.path_columns(self.state),
            "active_force_capacity": np.array(
                [muscle.calcInextensibleTendonActiveFiberForce(state, 1.0) for muscle in self.muscles]
            ),
            "generalized_forces": coupling.T @ net,
            "passive_generalized_forces": coupling.T @ self._passive_share(accelerations, net),
            "actuator_generalized_forces": coupling.T @ self._actuator_columns(accelerations, net),
            "other_forces": self._other_forces(),
        }
        result.update(self._skeleton(*self.poses))
        return result

    def _read(self, getter: str) -> Array:
        return np.array([getattr(self.coordinates[k], getter)(self.state) for k in self.free])

    def _accelerations(self, target: Array, constraints: Array) -> Array:
        """Complete the free coordinates' accelerations by those that the constraints imply."""
        accelerations = np.where(self.dependent, 0.0, target)
        if self.dependent.any():
            self.matter.calcBiasForAccelerationConstraints(self.state, self._vector)
            error = constraints @ accelerations + np.array(self._vector.to_numpy())
            own = constraints[:, self.dependent]
            accelerations[self.dependent] = -np.linalg.lstsq(own, error, rcond=RANK_TOLERANCE)[0]
        return accelerations

    def path_columns(self, state: Any, muscles: NDArray[np.int64] | None = None) -> Array:
        """Return the generalized force of each path, or of some, at 1 N tension, shape (n_u, n_muscles)."""
        osim, out = self.osim, self._vector
        chosen = range(len(self._paths)) if muscles is None else muscles.tolist()
        columns = np.zeros((self.n_u, len(chosen)))
        nothing = osim.Vector(self._no_mobility_forces)
        for j, m in enumerate(chosen):
            # the call adds to what it is given; only moving points and fitted paths add to mobilities
            body_forces = osim.VectorOfSpatialVec(self._no_body_forces)
            mobility_forces = osim.Vector(self._no_mobility_forces) if self._drives_mobilities[m] else nothing
            self._paths[m].addInEquivalentForces(state, 1.0, body_forces, mobility_forces)
            self.matter.multiplyBySystemJacobianTranspose(state, body_forces, out)
            columns[:, j] = out.to_numpy()
            if self._drives_mobilities[m]:
                columns[:, j] += mobility_forces.to_numpy()
        return columns

    def inverse_dynamics(self, accelerations: Array, state: Any = None) -> Array:
        """Return what must act on each mobility, all forces but muscles and actuators taken off."""
        vector = self.osim.Vector.createFromMat(np.ascontiguousarray(accelerations))
        solution = self._solver.solve(self.state if state is None else state, vector)
        return np.array(solution.to_numpy())

    def _passive_share(self, accelerations: Array, net: Array) -> Array:
        if not self.passives:
            return np.zeros(self.n_u)
        other = self._without_passives
        other.setTime(self.state.getTime())
        other.setQ(self.state.getQ())
        other.setU(self.state.getU())
        return self.inverse_dynamics(accelerations, other) - net

    def _actuator_columns(self, accelerations: Array, net: Array) -> Array:
        columns = np.zeros((self.n_u, len(self.actuators)))
        for j, actuator in enumerate(self.actuators):
            if j in self._constant_columns:
                coordinate, optimal_force = self._constant_columns[j]
                columns[coordinate, j] = optimal_force
                continue
            actuator.setOverrideActuation(self.state, float(actuator.getOptimalForce()))
            columns[:, j] = net - self.inverse_dynamics(accelerations)
            actuator.setOverrideActuation(self.state, 0.0)
        return columns

    def _other_forces(self) -> Array:
        values: list[float] = []
        if self._recorded:
            self.model.realizeDynamics(self.state)
        for force, n_labels in self._recorded:
            record = force.getRecordValues(self.state)
            found = record.getSize()
            if found != n_labels:
                raise Refusal(
                    f"the force {force.getName()!r} records {found} values under {n_labels} labels",
                    "EngineError",
                )
            values += [record.get(i) for i in range(n_labels)]
        return np.array(values, dtype=float)

    # -- skeleton

    def body_poses(
        self, state: Any, chosen: list[int] | None = None, others: tuple[Array, Array] | None = None
    ) -> tuple[Array, Array]:
        """Return rotation (columns are the body's axes) and origin of every body in ground.

        Bodies that are not chosen keep the poses given.
        """
        rotations, origins = np.zeros((len(self.body_names), 3, 3)), np.zeros((len(self.body_names), 3))
        rotations[0] = np.eye(3)
        if others is not None:
            rotations, origins = others[0].copy(), others[1].copy()
        for b in range(1, len(self.body_names)) if chosen is None else chosen:
            stations = [
                self.bodies[b - 1].findStationLocationInGround(state, point).to_numpy()
                for point in self._frame_points
            ]
            origins[b] = stations[0]
            rotations[b] = np.stack([station - stations[0] for station in stations[1:]], axis=1)
        return rotations, origins

    def body_velocities(self, state: Any) -> Array:
        """Return angular velocity and velocity of every body's origin per mobility, (n_bodies, 6, n_u)."""
        self.matter.calcSystemJacobian(state, self._matrix)
        jacobian = np.array(self._matrix.to_numpy()).reshape(-1, 6, self.n_u)
        velocities = np.zeros((len(self.body_names), 6, self.n_u))
        velocities[1:] = jacobian[self._mobilized]
        return velocities

    def _skeleton(self, rotations: Array, origins: Array) -> dict[str, Array]:
        forces, points, torques = self._load_vectors()
        children, _, centers = self._child_frames
        result = {
            "body_mass_centers": np.einsum("bij,bj->bi", rotations, self.mass_centers) + origins,
            "joint_centers": np.einsum("jab,jb->ja", rotations[children], centers) + origins[children],
            "joint_axes": self._joint_axes(rotations),
            "load_forces": forces,
            "load_points": points,
            "load_torques": torques,
        }
        result.update(self._path_points(rotations, origins))
        return result

    def _joint_axes(self, rotations: Array) -> Array:
        """Return the axes x, y, z of every joint in ground, one per row."""
        parents, offsets, _ = self._parent_frames
        angles = np.zeros((len(self.joints), 2))
        for j, functions in enumerate(self._rotation_functions):
            if functions is not None:
                angles[j] = [function.getValue(self.state) for function in functions[:2]]
        axes = self._nominal_axes
        first = rotation(axes[:, 0], angles[:, 0])
        second = first @ rotation(axes[:, 1], angles[:, 1])
        successive = np.stack(
            [
                axes[:, 0],
                np.einsum("jab,jb->ja", first, axes[:, 1]),
                np.einsum("jab,jb->ja", second, axes[:, 2]),
            ],
            axis=1,
        )
        named = np.take_along_axis(successive, self._axis_orders[:, :, None], axis=1)
        named = named * self._axis_signs[:, :, None]
        return np.einsum("jab,jub->jua", rotations[parents] @ offsets, named)

    def _load_vectors(self) -> tuple[Array, Array, Array]:
        n_loads, time, state = len(self.loads), self.state.getTime(), self.state
        forces, points, torques = np.zeros((n_loads, 3)), np.zeros((n_loads, 3)), np.zeros((n_loads, 3))
        for i, load in enumerate(self.loads):
            expressed = self._physical_frame(load.getForceExpressedInBodyName() or "ground")
            if load.get_force_identifier().lower() not in ("", "unassigned"):
                force = load.getForceAtTime(time)
                forces[i] = expressed.expressVectorInGround(state, force).to_numpy()
            if load.appliesTorque():
                torque = load.getTorqueAtTime(time)
                torques[i] = expressed.expressVectorInGround(state, torque).to_numpy()
            applied = self._physical_frame(load.getAppliedToBodyName())
            if load.specifiesPoint():
                frame = self._physical_frame(load.getPointExpressedInBodyName() or "ground")
                point = frame.findStationLocationInGround(state, load.getPointAtTime(time))
            else:
                point = applied.getPositionInGround(state)
            points[i] = point.to_numpy()
        return forces, points, torques

    def _path_points(self, rotations: Array, origins: Array) -> dict[str, Array]:
        per_muscle: list[tuple[NDArray[np.int64], Array, NDArray[np.bool_]]] = []
        for geometry, fixed in zip(self.geometry, self.fixed_points, strict=True):
            if fixed is not None:
                bodies, locations = fixed
                points = np.einsum("pij,pj->pi", rotations[bodies], locations) + origins[bodies]
                per_muscle.append((bodies, points, np.zeros(len(bodies), dtype=bool)))
                continue
            current = geometry.getCurrentPath(self.state)
            size = current.getSize()
            bodies = np.zeros(size, dtype=np.int64)
            points = np.zeros((size, 3))
            moves = np.zeros(size, dtype=bool)
            for i in range(size):
                point = current.get(i)
                bodies[i] = self.base_body(point.getParentFrame())
                points[i] = point.getLocationInGround(self.state).to_numpy()
                moves[i] = point.getConcreteClassName() in ("PathWrapPoint", "MovingPathPoint")
            per_muscle.append((bodies, points, moves))
        n_muscles, n_points = len(per_muscle), max(len(bodies) for bodies, _, _ in per_muscle)
        result: dict[str, Any] = {
            "path_points": np.zeros((n_muscles, n_points, 3)),
            "path_point_bodies": np.full((n_muscles, n_points), -1, dtype=np.int64),
            "path_point_moves": np.zeros((n_muscles, n_points), dtype=bool),
        }
        for m, (bodies, points, moves) in enumerate(per_muscle):
            result["path_points"][m, : len(bodies)] = points
            result["path_point_bodies"][m, : len(bodies)] = bodies
            result["path_point_moves"][m, : len(bodies)] = moves
        return result

    # -- constants

    def header(self) -> dict[str, Any]:
        """Return names and constants, the same in every worker."""
        gravity = self.model.getGravity()
        return {
            "model_name": self.model.getName(),
            "muscles": self.muscle_names,
            "actuators": self.actuator_names,
            "coordinates": [self.coordinate_names[k] for k in self.free],
            "is_rotational": [bool(self.is_rotational[k]) for k in self.free],
            "force_columns": self.force_columns,
            "other_force_labels": self.other_labels,
            "bodies": self.body_names,
            "body_parents": self.body_parents.tolist(),
            "body_masses": self.body_masses.tolist(),
            "gravity": [gravity.get(i) for i in range(3)],
            "joints": self.joint_names,
            "joint_children": self.joint_children,
            "load_names": [load.getName() for load in self.loads],
            "load_bodies": [self.load_body(load) for load in self.loads],
            "muscle_parameters": self._muscle_parameters(),
            "actuator_parameters": {
                "optimal_force": [float(actuator.getOptimalForce()) for actuator in self.actuators],
                "min_control": [float(actuator.getMinControl()) for actuator in self.actuators],
                "max_control": [float(actuator.getMaxControl()) for actuator in self.actuators],
            },
        }

    def _muscle_parameters(self) -> dict[str, list[Any]]:
        getters: dict[str, Callable[[Any], Any]] = {
            "muscle_class": lambda muscle: muscle.getConcreteClassName(),
            "max_isometric_force": lambda muscle: float(muscle.getMaxIsometricForce()),
            "optimal_fiber_length": lambda muscle: float(muscle.getOptimalFiberLength()),
            "tendon_slack_length": lambda muscle: float(muscle.getTendonSlackLength()),
            "pennation_angle_at_optimal": lambda muscle: float(
                muscle.getPennationAngleAtOptimalFiberLength()
            ),
            "max_contraction_velocity": lambda muscle: float(muscle.getMaxContractionVelocity()),
            "min_activation": lambda muscle: float(muscle.getMinControl()),
            "max_activation": lambda muscle: float(muscle.getMaxControl()),
            "activation_time_constant": lambda muscle: self._number(muscle, "activation_time_constant", 0.0),
            "deactivation_time_constant": lambda muscle: self._number(
                muscle, "deactivation_time_constant", 0.0
            ),
            "curve_parameters": self._curve_parameters,
        }
        return {name: [getter(muscle) for muscle in self.muscles] for name, getter in getters.items()}

    def _number(self, owner: Any, name: str, default: float | None) -> float | None:
        if not owner.hasProperty(name):
            return default
        value = owner.getPropertyByName(name)
        if value.size() != 1:
            return default
        helper = self.osim.PropertyHelper
        if value.getTypeName() == "bool":
            return float(helper.getValueBool(value))
        return float(helper.getValueDouble(value))

    def _curve_parameters(self, muscle: Any) -> dict[str, float]:
        parameters: dict[str, float] = {}
        for name in CURVE_PROPERTIES:
            value = self._number(muscle, name, None)
            if value is not None:
                parameters[name] = value
        osim = self.osim
        for kind in ("Millard2012EquilibriumMuscle", "Thelen2003Muscle"):
            exact = getattr(osim, kind).safeDownCast(muscle)
            if exact is not None and hasattr(exact, "getMinimumFiberLength"):
                parameters["minimum_fiber_length"] = float(exact.getMinimumFiberLength())
        if osim.RigidTendonMuscle.safeDownCast(muscle) is not None:
            for name in SPLINES:
                spline = osim.SimmSpline.safeDownCast(muscle.getPropertyByName(name).getValueAsObject(0))
                if spline is None:
                    parameters[f"{name}.other_function"] = 1.0
                    continue
                for i in range(spline.getSize()):
                    parameters[f"{name}.x{i}"] = float(spline.getX(i))
                    parameters[f"{name}.y{i}"] = float(spline.getY(i))
        millard = osim.Millard2012EquilibriumMuscle.safeDownCast(muscle)
        if millard is None:
            return parameters
        for prefix, getter in CURVE_OBJECTS.items():
            curve = getattr(millard, getter)()
            for i in range(curve.getNumProperties()):
                entry = curve.getPropertyByIndex(i)
                name = entry.getName()
                if entry.getTypeName() != "double":
                    continue
                value = self._number(curve, name, None)
                if value is None and name in CURVE_VALUES_IN_USE:
                    value = float(getattr(curve, CURVE_VALUES_IN_USE[name])())
                if value is not None:
                    parameters[f"{prefix}.{name}"] = value
        return parameters


def _load_model(osim: Any, given: dict[str, Any]) -> tuple[Any, Any]:
    """Load the model with the actuators and external loads that the setup adds."""
    model = osim.Model(given["model"])
    tool = osim.AnalyzeTool()
    files = osim.ArrayStr()
    for path in given["actuators"]:
        files.append(path)
    tool.setForceSetFiles(files)
    tool.setReplaceForceSet(bool(given["replace_force_set"]))
    tool.updateModelForces(model, "")
    if given["external_loads"] is not None:
        loads = osim.ExternalLoads(given["external_loads"], True)
        model.addModelComponent(loads)
        loads.this.disown()
    return model, tool


def _forces(osim: Any, model: Any) -> Iterator[Any]:
    """Yield every force in the order in which OpenSim records them."""
    for component in model.getComponentsList():
        force = osim.Force.safeDownCast(component)
        if force is not None:
            yield force


def _unit(vector: Array) -> Array:
    length = float(np.linalg.norm(vector))
    return np.asarray(vector) / length if length > 0 else np.asarray(vector)


def rotation(axes: Array, angles: Array) -> Array:
    """Return rotation matrices about unit axes.

    Parameters
    ----------
    axes : ndarray, shape (n, 3) [-]
    angles : ndarray, shape (n,) [rad]

    Returns
    -------
    ndarray, shape (n, 3, 3)
    """
    cross = cross_matrices(axes)
    angles = np.asarray(angles)[:, None, None]
    return np.eye(3) + np.sin(angles) * cross + (1.0 - np.cos(angles)) * (cross @ cross)


def cross_matrices(vectors: Array) -> Array:
    """Return the matrices that take the cross product with vectors from the left.

    Parameters
    ----------
    vectors : ndarray, shape (..., 3)

    Returns
    -------
    ndarray, shape (..., 3, 3)
    """
    matrices = np.zeros((*vectors.shape[:-1], 3, 3))
    for i, j, k in ((0, 1, 2), (1, 2, 0), (2, 0, 1)):
        matrices[..., i, j], matrices[..., j, i] = -vectors[..., k], vectors[..., k]
    return matrices


# ------------------------------------------------------------------------------------- virtual rotations


class VirtualRotations:
    """Turns everything distal of a joint rigidly about one of its axes and asks OpenSim for the path forces.

    In a second copy of the model a massless body with six free coordinates stands between each joint asked
    for and its parent body. At zero the model is as before; a finite rotation about any axis through any
    point is a rotation and a translation of that body.
    """

    def __init__(self, engine: Engine, given: dict[str, Any]) -> None:
        osim = engine.osim
        self.engine = engine
        self.rows: list[tuple[int, int]] = []
        for joint, axis in given["stability_axes"]:
            if joint not in engine.joint_names:
                raise Refusal(
                    f"unknown joint {joint!r} in stability_axes (joints that can move: "
                    f"{', '.join(engine.joint_names)})",
                    "NameMismatchError",
                )
            self.rows.append((engine.joint_names.index(joint), "xyz".index(axis)))
        self.names = [f"{joint}_{axis}" for joint, axis in given["stability_axes"]]
        self.model, self._tool = _load_model(osim, {**given, "external_loads": None})
        self.model.finalizeConnections()
        joints = sorted({joint for joint, _ in self.rows})
        for j in joints:
            self._insert(engine.joint_names[j])
        self.state = self.model.initSystem()
        self.model.setAllControllersEnabled(False)
        self.model.realizePosition(self.state)
        self.matter = self.model.getMatterSubsystem()
        paths = [
            name.removesuffix("/value") for name in osim.createStateVariableNamesInSystemOrder(self.model)
        ]
        self._coordinates = [
            osim.Coordinate.safeDownCast(self.model.getComponent(coordinate.getAbsolutePathString()))
            for coordinate in engine.coordinates
        ]
        self._extra: dict[int, tuple[list[Any], int]] = {}
        for j in joints:
            joint = self.model.getJointSet().get(f"scso_virtual_joint_{engine.joint_names[j]}")
            extra = [joint.get_coordinates(i) for i in range(6)]
            self._extra[j] = (extra, paths.index(extra[0].getAbsolutePathString()))
        self._paths = [self.model.getMuscles().get(name).getPath() for name in engine.muscle_names]
        n_bodies = self._system_size()
        nothing = osim.SpatialVec(osim.Vec3(0), osim.Vec3(0))
        self._no_body_forces = osim.VectorOfSpatialVec(n_bodies, nothing)
        self._no_mobility_forces = osim.Vector(self.state.getNU(), 0.0)
        self._out = osim.Vector()
        self._crossing = [self._crossing_muscles(j) for j, _ in self.rows]

    def _insert(self, name: str) -> None:
        osim, model = self.engine.osim, self.model
        joint = model.updJointSet().get(name)
        frame = joint.getParentFrame()
        base = osim.PhysicalFrame.safeDownCast(frame.findBaseFrame())
        offset = frame.findTransformInBaseFrame()
        zero = osim.Vec3(0)
        body = osim.Body(f"scso_virtual_body_{name}", 0.0, zero, osim.Inertia(0, 0, 0, 0, 0, 0))
        model.addBody(body)
        model.addJoint(osim.FreeJoint(f"scso_virtual_joint_{name}", base, body))
        inner = osim.PhysicalOffsetFrame(f"scso_virtual_frame_{name}", body, offset)
        model.addComponent(inner)
        joint.connectSocket_parent_frame(inner)

    def _system_size(self) -> int:
        matrix = self.engine.osim.Matrix()
        self.matter.calcSystemJacobian(self.state, matrix)
        return int(matrix.to_numpy().shape[0]) // 6

    def _crossing_muscles(self, joint: int) -> list[tuple[int, bool]]:
        """Return the muscles whose path may change, and whether they have points on both sides.

        Fitted paths (FunctionBasedPath) have no points: for them nothing is known about a virtual rotation.
        """
        engine = self.engine
        distal = engine.distal_bodies(engine.joint_children[joint])
        result = []
        for m, geometry in enumerate(engine.geometry):
            if geometry is None or not engine.moves[m]:
                continue
            sides = {body in distal for body in engine.path_bodies(m)}
            result.append((m, len(sides) == 2))
        return result

    def frame(self, frame: dict[str, Array], poses: tuple[Array, Array]) -> dict[str, Array]:
        """Return virtual moment arms and curvature of the pose that the engine is in."""
        engine = self.engine
        n_muscles = len(engine.muscle_names)
        arms = np.full((len(self.rows), n_muscles), np.nan)
        curvature = np.full((len(self.rows), n_muscles), np.nan)
        self.state.setTime(engine.state.getTime())
        for k, coordinate in enumerate(self._coordinates):
            if not engine.is_locked[k]:
                coordinate.setValue(self.state, engine.coordinates[k].getValue(engine.state), False)
        for extra, _ in self._extra.values():
            for coordinate in extra:
                coordinate.setValue(self.state, 0.0, False)
        rotations, origins = poses
        for i, (j, u) in enumerate(self.rows):
            parent = engine.joint_parents[j]
            center = rotations[parent].T @ (frame["joint_centers"][j] - origins[parent])
            axis = rotations[parent].T @ frame["joint_axes"][j, u]
            for m, crosses in self._crossing[i]:
                if not crosses:
                    arms[i, m] = curvature[i, m] = 0.0
            crossing = [m for m, crosses in self._crossing[i] if crosses]
            if not crossing:
                continue
            before, arms[i, crossing], after = (
                self._arms(j, center, axis, angle, crossing) for angle in (-VIRTUAL_STEP, 0.0, VIRTUAL_STEP)
            )
            curvature[i, crossing] = -(after - before) / (2.0 * VIRTUAL_STEP)
            for coordinate in self._extra[j][0]:
                coordinate.setValue(self.state, 0.0, False)
        return {"virtual_moment_arms": arms, "virtual_curvature": curvature}

    def _arms(self, joint: int, center: Array, axis: Array, angle: float, muscles: list[int]) -> Array:
        """Return the moment arms about an axis through a center of the parent body, turned by an angle."""
        osim, state = self.engine.osim, self.state
        turned = rotation(axis[None], np.array([angle]))[0]
        shift = center - turned @ center
        # body-fixed x, y, z angles, the coordinates of a free joint
        values = [
            float(np.arctan2(-turned[1, 2], turned[2, 2])),
            float(np.arcsin(np.clip(turned[0, 2], -1.0, 1.0))),
            float(np.arctan2(-turned[0, 1], turned[0, 0])),
            *shift.tolist(),
        ]
        extra, first = self._extra[joint]
        for coordinate, value in zip(extra, values, strict=True):
            coordinate.setValue(state, value, False)
        self.model.realizePosition(state)
        mobility_forces = osim.Vector(self._no_mobility_forces)
        arms = np.zeros(len(muscles))
        for i, m in enumerate(muscles):
            body_forces = osim.VectorOfSpatialVec(self._no_body_forces)
            self._paths[m].addInEquivalentForces(state, 1.0, body_forces, mobility_forces)
            self.matter.multiplyBySystemJacobianTranspose(state, body_forces, self._out)
            generalized = self._out.to_numpy()[first : first + 6]
            torque, force = generalized[:3], generalized[3:]
            arms[i] = axis @ (torque + np.cross(shift - center, force))
        return arms


# -------------------------------------------------------------------------------- coordinate derivatives


@dataclass(frozen=True, kw_only=True)
class PathsNearby:
    """Paths at one point of the stencil.

    Attributes
    ----------
    arms : ndarray, shape (n_chosen, n) [m]
        Moment arms of the muscles asked for.
    sizes : ndarray of int, shape (n,)
        Numbers of points of their paths.
    """

    arms: Array
    sizes: NDArray[np.int64]


@dataclass(frozen=True, kw_only=True)
class BodiesNearby:
    """What follows from bodies at one point of the stencil.

    Attributes
    ----------
    arms : ndarray, shape (n_chosen, n_fixed) [m]
        Moment arms of the muscles whose points are all fixed to bodies.
    loads, passive : ndarray, shape (n_chosen,) [N·m]
        Generalized forces of weights and external loads, and of passive elements, at rest.
    """

    arms: Array
    loads: Array
    passive: Array


def _close(one: Array, other: Array) -> NDArray[np.bool_]:
    """Tell which derivatives of moment arms agree."""
    size = np.maximum(np.abs(one), np.abs(other))
    return np.abs(one - other) <= SAME_SLOPE + SAME_SLOPE_SHARE * size


class CoordinateDerivatives:
    """Derivatives of moment arms, loads and passive forces with respect to chosen free coordinates.

    Central differences of moment arms, reduced to the free coordinates at every point of the stencil, so
    that dependent coordinates follow their constraints. Moment arms are OpenSim's own; only those of points
    fixed to bodies, along coordinates without splines, come from the bodies' poses and velocities, all
    muscles together. Where a path changes its points or two steps disagree, the side or step without the
    artefact is taken and the muscle is marked.
    """

    def __init__(self, engine: Engine, chosen: list[str]) -> None:
        self.engine = engine
        self._depends = self._dependence()
        self.columns = self._choose(chosen)
        self.names = [engine.coordinate_names[engine.free[c]] for c in self.columns]
        self._depends = self._depends[:, self.columns]
        self._smooth = np.array([self._is_smooth(engine.free[c]) for c in self.columns], dtype=bool)
        osim = engine.osim
        self.state = osim.State(engine.state)
        for load in engine.loads:
            load.setAppliesForce(self.state, False)
        self._rest = osim.Vector(engine.n_u, 0.0)
        self._no_acceleration = np.zeros(engine.n_u)
        self._unconstrained = np.zeros((0, engine.n_u))
        self._gravity = np.array(engine.model.getGravity().to_numpy())
        self._moved = self._moved_bodies()
        followers = self._followers()
        self._has_followers = [len(followers[int(engine.free[c])]) > 1 for c in self.columns]
        self._load_bodies = np.array([engine.load_body(load) for load in engine.loads], dtype=np.int64)
        self._lay_out_fixed_paths()
        #: frames in which each muscle's curvature is uncertain
        self.uncertain = np.zeros(len(engine.muscles), dtype=np.int64)

    # -- what depends on what

    def _dependence(self) -> NDArray[np.bool_]:
        """Tell which muscles' lengths depend on which free coordinates, shape (n_muscles, n_free)."""
        engine = self.engine
        followers = self._followers()
        distal = {
            k: engine.distal_bodies(engine.child_of_coordinate(k)) for k in set().union(*followers.values())
        }
        depends = np.zeros((len(engine.muscles), len(engine.free)), dtype=bool)
        for m, geometry in enumerate(engine.geometry):
            if geometry is None:
                depends[m] = True
                continue
            bodies, drivers = engine.path_bodies(m), self._path_coordinates(geometry)
            for c, k in enumerate(engine.free.tolist()):
                depends[m, c] = any(
                    moved in drivers or len({body in distal[moved] for body in bodies}) == 2
                    for moved in followers[k]
                )
        return depends

    def _moved_bodies(self) -> list[int]:
        """Return the bodies that move with any chosen coordinate."""
        engine, followers = self.engine, self._followers()
        moved = {k for c in self.columns for k in followers[int(engine.free[c])]}
        return sorted(set().union(*(engine.distal_bodies(engine.child_of_coordinate(k)) for k in moved)))

    def _followers(self) -> dict[int, set[int]]:
        """Return every coordinate that moves with each free one, itself included."""
        engine = self.engine
        coupled = {target for target, *_ in engine.couplers}
        loops = {k for k in np.flatnonzero(engine.dependent).tolist() if k not in coupled}
        loops = {k for k in loops if not engine.is_set_by_model[k]}
        followers = {k: {k} | loops for k in engine.free.tolist()}
        for _ in range(max(len(engine.couplers), 1)):
            for target, where, *_ in engine.couplers:
                for moved in followers.values():
                    if moved & set(where):
                        moved.add(target)
        return followers

    def _path_coordinates(self, geometry: Any) -> set[int]:
        """Return the coordinates that moving and conditional points of a path look at."""
        engine, osim = self.engine, self.engine.osim
        found = set()
        points = geometry.getPathPointSet()
        for i in range(points.getSize()):
            for kind, sockets in (
                ("MovingPathPoint", ("x_coordinate", "y_coordinate", "z_coordinate")),
                ("ConditionalPathPoint", ("coordinate",)),
            ):
                if points.get(i).getConcreteClassName() != kind:
                    continue
                point = getattr(osim, kind).safeDownCast(points.get(i))
                for socket in sockets:
                    if point.getSocket(socket).isConnected():
                        name = osim.Coordinate.safeDownCast(point.getConnectee(socket)).getName()
                        found.add(engine.coordinate_names.index(name))
        return found

    def _choose(self, chosen: list[str]) -> list[int]:
        engine = self.engine
        free = [engine.coordinate_names[k] for k in engine.free]
        if chosen == ["all"]:
            return np.flatnonzero(self._depends.any(axis=0)).tolist()
        for name in chosen:
            if name in free:
                continue
            if name in engine.coordinate_names:
                raise Refusal(
                    f"curvature_coordinates names {name!r}, which the model locks, prescribes or couples to "
                    f"others (free: {', '.join(free)})"
                )
            raise Refusal(
                f"unknown coordinate {name!r} in curvature_coordinates (free: {', '.join(free)})",
                "NameMismatchError",
            )
        return [free.index(name) for name in chosen]

    def _is_smooth(self, k: int) -> bool:
        """Tell whether a coordinate moves its joint by straight lines and circles only."""
        engine, osim = self.engine, self.engine.osim
        if any(k in where for _, where, *_ in engine.couplers) or self._followers()[k] != {k}:
            return False
        custom = osim.CustomJoint.safeDownCast(engine.coordinates[k].getJoint())
        if custom is None:
            return engine.coordinates[k].getJoint().getConcreteClassName() in SMOOTH_JOINTS
        transform = custom.getSpatialTransform()
        functions = [transform.getTransformAxis(i).getFunction() for i in range(6)]
        return all(self._is_linear(function) for function in functions)

    def _is_linear(self, function: Any) -> bool:
        multiplier = self.engine.osim.MultiplierFunction.safeDownCast(function)
        inner = function if multiplier is None else multiplier.getFunction()
        return inner.getConcreteClassName() in ("LinearFunction", "Constant")

    # -- one frame

    def frame(self, frame: dict[str, Array]) -> dict[str, Array]:
        """Return the derivatives at the pose that the engine is in."""
        engine, n = self.engine, len(self.columns)
        n_muscles = len(engine.muscles)
        self._take_pose()
        rotations, origins = engine.poses
        bodies = self._load_bodies
        # where the loads act, fixed to their bodies
        self._load_points = np.einsum("lba,lb->la", rotations[bodies], frame["load_points"] - origins[bodies])
        slopes = np.zeros((n, n, n_muscles))
        loads, passive = np.zeros((n, n)), np.zeros((n, n))
        is_uncertain = np.zeros(n_muscles, dtype=bool)
        base = frame["moment_arms"][self.columns]
        sizes = self._sizes(np.arange(n_muscles))
        for j in range(n):
            muscles = np.flatnonzero(self._depends[:, j])
            others = muscles[[not self._smooth[j] or engine.moves[m] for m in muscles]]
            before, after = (self._bodies_at(j, sign * FINE_STEP, frame) for sign in (-1, 1))
            slopes[:, j, self._fixed] = (after.arms - before.arms) / (2 * FINE_STEP)
            loads[:, j] = -(after.loads - before.loads) / (2 * FINE_STEP)
            passive[:, j] = -(after.passive - before.passive) / (2 * FINE_STEP)
            if others.size:
                slopes[:, j, others], doubtful = self._judge(j, others, base[:, others], sizes[others])
                is_uncertain[others] |= doubtful
            self._set(j, 0.0)
        # a muscle's own rows only: beyond wraps OpenSim has traces of moment arms that no length follows
        slopes *= self._depends.T[:, None, :] & self._depends.T[None, :, :]
        asymmetry = np.abs(slopes - slopes.transpose(1, 0, 2)).max(axis=(0, 1), initial=0.0)
        self.uncertain += is_uncertain
        return {
            # adding zero turns -0 into 0
            "path_curvature": -(slopes + slopes.transpose(1, 0, 2)) / 2 + 0.0,
            "load_stiffness": (loads + loads.T) / 2 + 0.0,
            "passive_stiffness": (passive + passive.T) / 2 + 0.0,
            "asymmetry": asymmetry,
            "is_uncertain": is_uncertain,
        }

    def _judge(
        self, j: int, muscles: NDArray[np.int64], base: Array, sizes: NDArray[np.int64]
    ) -> tuple[Array, NDArray[np.bool_]]:
        """Compare two steps on both sides; return the better slopes and the muscles that are uncertain.

        Parameters
        ----------
        j : int
            Chosen coordinate that moves.
        muscles : ndarray of int, shape (n,)
        base : ndarray, shape (n_chosen, n) [m]
            Moment arms in the frame.
        sizes : ndarray of int, shape (n,)
            Numbers of path points in the frame.
        """
        near, far = ([self._at(j, sign * step, muscles) for sign in (-1, 1)] for step in (STEP, WIDE_STEP))
        slopes = (near[1].arms - near[0].arms) / (2 * STEP)
        large = (far[1].arms - far[0].arms) / (2 * WIDE_STEP)
        agree = _close(slopes, large).all(axis=0)
        same = [(near[i].sizes == sizes) & (far[i].sizes == sizes) for i in range(2)]
        doubtful = ~(agree & same[0] & same[1])
        if not doubtful.any():
            return slopes, doubtful
        clean, one_sided = [], []
        for i, sign in enumerate((-1.0, 1.0)):
            short = sign * (near[i].arms - base) / STEP
            long = sign * (far[i].arms - base) / WIDE_STEP
            clean.append(same[i] & _close(short, long).all(axis=0))
            # the parabola through three points, its slope at the frame
            one_sided.append((short * WIDE_STEP - long * STEP) / (WIDE_STEP - STEP))
        for i in range(2):
            alone = doubtful & clean[i] & ~clean[1 - i]
            slopes[:, alone] = one_sided[i][:, alone]
        neither = doubtful & ~clean[0] & ~clean[1]
        if neither.any():
            wide = [self._at(j, sign * WIDEST_STEP, muscles[neither]).arms for sign in (-1, 1)]
            slopes[:, neither] = (wide[1] - wide[0]) / (2 * WIDEST_STEP)
        return slopes, doubtful

    def _take_pose(self) -> None:
        """Take the engine's pose, at rest."""
        state = self.state
        state.setTime(self.engine.state.getTime())
        state.setQ(self.engine.state.getQ())
        state.setU(self._rest)
        self.engine.model.realizePosition(state)
        self._values = [coordinate.getValue(state) for coordinate in self.engine.coordinates]
        self._frame_coupling = self._coupling()

    def _move(self, j: int, step: float) -> None:
        """Move one chosen coordinate away from the frame's pose; dependent ones follow."""
        self._set(j, step)
        self.engine.model.realizePosition(self.state)
        if self._has_followers[j]:
            self.engine.close_loops(self.state)

    def _set(self, j: int, step: float) -> None:
        engine, state = self.engine, self.state
        values = np.array(self._values)
        k = int(engine.free[self.columns[j]])
        values[k] += step
        moved = [k]
        if self._has_followers[j]:
            engine.follow(values)
            moved += np.flatnonzero(engine.dependent).tolist()
        for i in moved:
            if not engine.is_locked[i]:
                engine.coordinates[i].setValue(state, float(values[i]), False)

    def _at(self, j: int, step: float, muscles: NDArray[np.int64]) -> PathsNearby:
        """Return OpenSim's moment arms of some muscles at a point of the stencil."""
        self._move(j, step)
        arms = self._coupling(j).T @ self.engine.path_columns(self.state, muscles)
        return PathsNearby(arms=arms, sizes=self._sizes(muscles))

    def _coupling(self, j: int | None = None) -> Array:
        """Return du over the speeds of the chosen coordinates, shape (n_u, n_chosen).

        It stays as it is in the frame when a coordinate moves that no other one follows.
        """
        engine = self.engine
        if j is not None and not self._has_followers[j]:
            return self._frame_coupling
        constraints = engine.constraint_matrix(self.state) if engine.is_constrained else self._unconstrained
        return engine.coupling(constraints)[:, self.columns]

    def _bodies_at(self, j: int, step: float, frame: dict[str, Array]) -> BodiesNearby:
        """Return what follows from the bodies' poses and velocities at a point of the stencil."""
        engine = self.engine
        self._move(j, step)
        coupling = self._coupling(j)
        rotations, origins = engine.body_poses(self.state, self._moved, engine.poses)
        velocities = engine.body_velocities(self.state) @ coupling
        turning, moving = velocities[:, :3], velocities[:, 3:]

        def shifts(bodies: NDArray[np.int64], arms: Array) -> Array:
            """Velocities of points at some arm from their bodies' origins, (..., 3, n_chosen)."""
            return moving[bodies] - cross_matrices(arms) @ turning[bodies]

        bodies = self._point_bodies
        arms = np.einsum("mpij,mpj->mpi", rotations[bodies], self._point_locations)
        segments = np.diff(origins[bodies] + arms, axis=1)
        lengths = np.linalg.norm(segments, axis=2)
        directions = np.where(self._is_segment[..., None], segments, 0.0)
        directions /= np.where(self._is_segment, lengths, 1.0)[..., None]
        moment_arms = -np.einsum("mpi,mpic->cm", directions, np.diff(shifts(bodies, arms), axis=1))
        weights = engine.body_masses[:, None] * self._gravity
        every = np.arange(len(weights))
        centers = np.einsum("bij,bj->bi", rotations, engine.mass_centers)
        weight = np.einsum("bi,bic->c", weights, shifts(every, centers))
        load_arms = np.einsum("lij,lj->li", rotations[self._load_bodies], self._load_points)
        load = np.einsum("li,lic->c", frame["load_forces"], shifts(self._load_bodies, load_arms))
        load += np.einsum("li,lic->c", frame["load_torques"], turning[self._load_bodies])
        passive = np.zeros(len(self.columns))
        if engine.passives:
            passive = -coupling.T @ engine.inverse_dynamics(self._no_acceleration, self.state) - weight
        return BodiesNearby(arms=moment_arms, loads=weight + load, passive=passive)

    def _lay_out_fixed_paths(self) -> None:
        """Put the points of all paths that are fixed to bodies into arrays, padded by their last point."""
        engine = self.engine
        self._fixed = np.array([m for m, moves in enumerate(engine.moves) if not moves], dtype=np.int64)
        paths = [path for path in (engine.fixed_points[m] for m in self._fixed) if path is not None]
        n_points = max((len(bodies) for bodies, _ in paths), default=1)
        self._point_bodies = np.zeros((len(paths), n_points), dtype=np.int64)
        self._point_locations = np.zeros((len(paths), n_points, 3))
        self._is_segment = np.zeros((len(paths), n_points - 1), dtype=bool)
        for i, (bodies, locations) in enumerate(paths):
            self._point_bodies[i], self._point_locations[i] = bodies[-1], locations[-1]
            self._point_bodies[i, : len(bodies)], self._point_locations[i, : len(bodies)] = bodies, locations
            self._is_segment[i, : len(bodies) - 1] = True

    def _sizes(self, muscles: NDArray[np.int64]) -> NDArray[np.int64]:
        """Return the numbers of path points; 0 for paths whose points never change."""
        engine = self.engine
        sizes = np.zeros(len(engine.muscles), dtype=np.int64)
        for m in muscles:
            geometry = engine.geometry[m]
            if engine.moves[m] and geometry is not None:
                sizes[m] = geometry.getCurrentPath(self.state).getSize()
        return sizes[muscles]


if __name__ == "__main__":
    sys.exit(main())
