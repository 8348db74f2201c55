"""Ask OpenSim itself about an example folder and save its numbers; run as a script, in its own process.

    python opensim_numbers.py SETUP_FOLDER OUTPUT.npz

Nothing of scso_nlp is used. Every frame is taken at rest. Curvature and external work are second
differences of OpenSim's path lengths and of the potential energy of its weights and loads, turning each
coordinate in turn.
"""

import sys
import xml.etree.ElementTree as ET
from pathlib import Path

import numpy as np
import opensim

STEP = 2e-3  # [rad]; the five-point formula is then off by 1e-11 relative, round-off by 1e-9


def second_difference(function, at):
    """Five-point second difference of a vector function of one angle."""
    values = [np.asarray(function(at + k * STEP)) for k in (-2, -1, 0, 1, 2)]
    weights = (-1.0, 16.0, -30.0, 16.0, -1.0)
    return sum(w * v for w, v in zip(weights, values, strict=True)) / (12 * STEP**2)


def mixed_difference(function, at, i, j):
    """Four-point second derivative by coordinates i and j, and by i twice where they are the same."""
    total = 0.0
    for a, b, sign in ((1, 1, 1), (1, -1, -1), (-1, 1, -1), (-1, -1, 1)):
        moved = at.copy()
        moved[i] += a * STEP
        moved[j] += b * STEP
        total = total + sign * np.asarray(function(moved))
    return total / (4 * STEP**2)


def vector(v):
    return np.array([v.get(i) for i in range(3)])


def main(folder, output):
    log = output.with_suffix(".log")
    opensim.Logger.removeFileSink()
    opensim.Logger.addFileSink(str(log))
    setup = ET.parse(folder / "setup.xml").getroot().find("AnalyzeTool")
    model = opensim.Model(str(folder / setup.findtext("model_file")))
    loads_file = setup.findtext("external_loads_file")
    if loads_file:
        model.addModelComponent(opensim.ExternalLoads(str(folder / loads_file), True))
    state = model.initSystem()
    muscles = [model.getMuscles().get(i) for i in range(model.getMuscles().getSize())]
    for muscle in muscles:
        muscle.set_appliesForce(False)
    state = model.initSystem()
    names = [c.getName() for c in (model.getCoordinateSet().get(i) for i in range(model.getNumCoordinates()))]
    coordinates = [model.getCoordinateSet().get(name) for name in names]
    motion = opensim.TimeSeriesTable(str(folder / setup.findtext("coordinates_file")))
    time = np.array(motion.getIndependentColumn())
    angles = np.stack([np.deg2rad(motion.getDependentColumn(n).to_numpy()) for n in names], axis=1)
    solver = opensim.InverseDynamicsSolver(model)
    matter, gravity = model.getMatterSubsystem(), vector(model.getGravity())
    mass = model.getTotalMass(state)

    def place(values):
        for coordinate, value in zip(coordinates, values, strict=True):
            coordinate.setValue(state, float(value), False)
            coordinate.setSpeedValue(state, 0.0)
        model.realizePosition(state)

    def lengths(values):
        place(values)
        return [m.getLength(state) for m in muscles]

    external = None
    if loads_file:
        found = [f for f in model.getComponentsList() if f.getConcreteClassName() == "ExternalForce"]
        external = opensim.ExternalForce.safeDownCast(found[0])
        body = model.getBodySet().get(external.getAppliedToBodyName())

    def load_now(t):
        """Force, point in ground and point on the body of the external load."""
        force, point = vector(external.getForceAtTime(t)), vector(external.getPointAtTime(t))
        ground = model.getGround()
        return force, point, ground.findStationLocationInAnotherFrame(state, opensim.Vec3(*point), body)

    def energy_with(load):
        def energy(values):
            place(values)
            total = -mass * gravity @ vector(matter.calcSystemMassCenterLocationInGround(state))
            if load:
                force, _, station = load
                total -= force @ vector(body.findStationLocationInGround(state, station))
            return total

        return energy

    def turn(function, q, i):
        return second_difference(lambda angle: function(np.r_[q[:i], angle, q[i + 1 :]]), q[i])

    result = {key: [] for key in ("length", "moment_arms", "curvature", "external_work", "moments")}
    result |= {"length_hessian": [], "energy_hessian": []}
    loads = []
    for t, q in zip(time, angles, strict=True):
        state.setTime(float(t))
        result["length"].append(lengths(q))
        result["moment_arms"].append([[m.computeMomentArm(state, c) for m in muscles] for c in coordinates])
        load = load_now(float(t)) if external else None
        if load:
            loads.append([*load[0], *load[1]])
        energy = energy_with(load)
        result["curvature"].append([turn(lengths, q, i) for i in range(len(names))])
        result["external_work"].append([-turn(energy, q, i) for i in range(len(names))])
        pairs = [[(i, j) for j in range(len(names))] for i in range(len(names))]
        for key, function in (("length_hessian", lengths), ("energy_hessian", energy)):
            result[key].append([[mixed_difference(function, q, i, j) for i, j in row] for row in pairs])
        place(q)
        model.realizeVelocity(state)
        result["moments"].append(solver.solve(state).to_numpy())
    states_in_order = opensim.createStateVariableNamesInSystemOrder(model)
    tree = [name.split("/")[-2] for name in states_in_order if name.endswith("/value")]
    order = [tree.index(n) for n in names]
    result["moments"] = np.array(result["moments"])[:, order]

    tool = opensim.AnalyzeTool(str(folder / "setup.xml"))
    results = output.parent / f"{output.stem}_results"
    tool.setResultsDir(str(results))
    assert tool.run()
    states = tool.getStatesStorage()
    labels = [states.getColumnLabels().get(i) for i in range(states.getColumnLabels().size())]
    table = opensim.TimeSeriesTable(str(results / f"{tool.getName()}_StaticOptimization_activation.sto"))
    activation = table.getMatrix().to_numpy()
    speeds = []
    for k in range(states.getSize()):
        row = states.getStateVector(k).getData()
        speeds.append([row.get(i - 1) for i, n in enumerate(labels) if n.endswith("/speed")])
    np.savez(
        output,
        time=time,
        names=names,
        muscles=[m.getName() for m in muscles],
        loads=loads,
        max_isometric_force=[m.getMaxIsometricForce() for m in muscles],
        min_control=[m.getMinControl() for m in muscles],
        motion_types=[c.getMotionType() for c in coordinates],
        static_optimization=activation,
        tool_time=np.array(table.getIndependentColumn()),
        tool_speeds=speeds,
        total_mass=mass,
        warnings=[line for line in log.read_text().splitlines() if "[warning]" in line or "[error]" in line],
        **{key: np.array(value) for key, value in result.items()},
    )


if __name__ == "__main__":
    main(Path(sys.argv[1]).resolve(), Path(sys.argv[2]).resolve())
