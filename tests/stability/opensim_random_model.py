"""Build a random model in OpenSim and save its geometry and finite differences; run as a script.

    python opensim_random_model.py SEED OUTPUT.npz

Six bodies in a branching tree on hinges and on joints of three rotations, straight and via-point paths,
weights, and constant forces and torques at points of the bodies. Nothing of scso_nlp is used. Every
derivative is taken by turning the model's own coordinate, of OpenSim's own lengths and energies.
"""

import sys
from pathlib import Path

import numpy as np
import opensim

STEP = 2e-3  # [rad]
PARENTS = (-1, 0, 1, 2, 2, 4)
BALL = (False, True, False, True, False, True)  # joint above each body
N_PATHS, N_POINTS, N_LOADS, N_FRAMES = 40, 4, 3, 3


def vec3(values):
    return opensim.Vec3(*(float(v) for v in values))


def array(v):
    return np.array([v.get(i) for i in range(3)])


def second_difference(function, at):
    values = [np.asarray(function(at + k * STEP)) for k in (-2, -1, 0, 1, 2)]
    return sum(w * v for w, v in zip((-1.0, 16.0, -30.0, 16.0, -1.0), values, strict=True)) / (12 * STEP**2)


def first_difference(function, at):
    values = [np.asarray(function(at + k * STEP)) for k in (-2, -1, 1, 2)]
    return (values[0] - 8 * values[1] + 8 * values[2] - values[3]) / (12 * STEP)


def build(rng):
    model = opensim.Model()
    model.setName("random")
    model.setGravity(vec3(rng.normal(scale=6.0, size=3)))
    bodies, masses, rows = [model.getGround()], [0.0], []
    for index in range(1, len(PARENTS)):
        masses.append(rng.uniform(1.0, 15.0))
        center = vec3(rng.uniform(-0.2, 0.2, 3))
        body = opensim.Body(f"body{index}", masses[-1], center, opensim.Inertia(0.1, 0.1, 0.1))
        model.addBody(body)
        parent = bodies[PARENTS[index]]
        place = [vec3(rng.uniform(-0.2, 0.2, 3)) for _ in range(4)]
        frames = (parent, place[0], place[1], body, place[2], place[3])
        name = f"joint{index}"
        if BALL[index]:
            transform = opensim.SpatialTransform()
            axes, _ = np.linalg.qr(rng.normal(size=(3, 3)))
            for number, letter in enumerate("xyz"):
                rotation = getattr(transform, f"upd_rotation{number + 1}")()
                rotation.setCoordinateNames(opensim.ArrayStr(f"{name}_{letter}", 1))
                rotation.set_axis(vec3(axes[number]))
                rotation.set_function(opensim.LinearFunction(1.0, 0.0))
                rows.append(f"{name}_{letter}")
            joint = opensim.CustomJoint(name, *frames, transform)
        else:
            joint = opensim.PinJoint(name, *frames)
            joint.updCoordinate().setName(f"{name}_z")
            rows.append(f"{name}_z")
        model.addJoint(joint)
        bodies.append(body)
    path_bodies = np.full((N_PATHS, N_POINTS), -1)
    for index in range(N_PATHS):
        path = opensim.PathActuator()
        path.setName(f"muscle_{index}")
        for point in range(rng.integers(2, N_POINTS + 1)):
            path_bodies[index, point] = rng.integers(0, len(bodies))
            where = vec3(rng.uniform(-0.5, 0.5, 3))
            path.addNewPathPoint(f"{index}-{point}", bodies[path_bodies[index, point]], where)
        model.addForce(path)
    loads = []
    for index in range(N_LOADS):
        body = int(rng.integers(1, len(bodies)))
        force, station, torque = rng.normal(scale=80, size=3), rng.uniform(-0.3, 0.3, 3), rng.normal(size=3)
        load = opensim.PrescribedForce(f"load{index}", bodies[body])
        load.setForceFunctions(*(opensim.Constant(float(v)) for v in force))
        load.setPointFunctions(*(opensim.Constant(float(v)) for v in station))
        load.setTorqueFunctions(*(opensim.Constant(float(v)) for v in 20 * torque))
        load.setForceIsInGlobalFrame(True)
        load.setPointIsInGlobalFrame(False)
        model.addForce(load)
        loads.append((body, force, station, 20 * torque))
    model.finalizeConnections()
    return model, masses, rows, path_bodies, loads


def main(seed, output):
    opensim.Logger.removeFileSink()
    rng = np.random.default_rng(seed)
    model, masses, rows, path_bodies, loads = build(rng)
    state = model.initSystem()
    bodies = [model.getGround(), *(model.getBodySet().get(i) for i in range(len(PARENTS) - 1))]
    joints = [model.getJointSet().get(i) for i in range(model.getJointSet().getSize())]
    paths = [opensim.PathActuator.safeDownCast(model.getForceSet().get(i)) for i in range(N_PATHS)]
    paths = [p.getGeometryPath() for p in paths]
    for index in range(N_PATHS):
        model.getForceSet().get(index).set_appliesForce(False)
    state = model.initSystem()
    coordinates = [model.getCoordinateSet().get(row) for row in rows]
    order = [
        name.split("/")[-2]
        for name in opensim.createStateVariableNamesInSystemOrder(model)
        if name.endswith("/value")
    ]
    matter, gravity = model.getMatterSubsystem(), array(model.getGravity())
    solver = opensim.InverseDynamicsSolver(model)

    def place(values):
        for coordinate, value in zip(coordinates, values, strict=True):
            coordinate.setValue(state, float(value), False)
            coordinate.setSpeedValue(state, 0.0)
        model.realizeVelocity(state)

    def lengths(values):
        place(values)
        return [path.getLength(state) for path in paths]

    def energy(values):
        place(values)
        total = -sum(masses) * gravity @ array(matter.calcSystemMassCenterLocationInGround(state))
        for body, force, station, _ in loads:
            total -= force @ array(bodies[body].findStationLocationInGround(state, vec3(station)))
        return total

    def moments(values):
        place(values)
        return solver.solve(state).to_numpy()[[order.index(row) for row in rows]]

    names = ("centers", "axes", "mass_centers", "points", "load_points", "length", "moment_arms")
    names += ("curvature", "length_slope", "energy_curvature", "moment_slope")
    result = {name: [] for name in names}
    for _ in range(N_FRAMES):
        q = rng.uniform(-1.2, 1.2, len(rows))
        place(q)
        result["centers"].append([array(j.getChildFrame().getPositionInGround(state)) for j in joints])
        result["mass_centers"].append(
            [np.zeros(3)]
            + [array(b.findStationLocationInGround(state, b.getMassCenter())) for b in bodies[1:]]
        )
        result["points"].append(
            [
                [
                    array(path.getPathPointSet().get(p).getLocationInGround(state))
                    if p < path.getPathPointSet().getSize()
                    else np.zeros(3)
                    for p in range(N_POINTS)
                ]
                for path in paths
            ]
        )
        result["load_points"].append(
            [array(bodies[b].findStationLocationInGround(state, vec3(s))) for b, _, s, _ in loads]
        )
        result["length"].append(lengths(q))
        result["moment_arms"].append([[p.computeMomentArm(state, c) for p in paths] for c in coordinates])
        # The axis of a coordinate is the relative angular velocity of the joint at a speed of one.
        axes = np.tile(np.eye(3), (len(joints), 1, 1))
        for row, coordinate in zip(rows, coordinates, strict=True):
            joint = joints[int(row[5]) - 1]
            coordinate.setSpeedValue(state, 1.0)
            model.realizeVelocity(state)
            spin = array(joint.getChildFrame().getAngularVelocityInGround(state))
            spin -= array(joint.getParentFrame().getAngularVelocityInGround(state))
            coordinate.setSpeedValue(state, 0.0)
            axes[int(row[5]) - 1, "xyz".index(row[-1])] = spin / np.linalg.norm(spin)
        result["axes"].append(axes)
        for name in ("curvature", "length_slope", "energy_curvature", "moment_slope"):
            result[name].append([])
        for i in range(len(rows)):

            def along(function, i=i, q=q):
                return lambda value: function(np.r_[q[:i], value, q[i + 1 :]])

            result["curvature"][-1].append(second_difference(along(lengths), q[i]))
            result["length_slope"][-1].append(first_difference(along(lengths), q[i]))
            result["energy_curvature"][-1].append(second_difference(along(energy), q[i]))
            result["moment_slope"][-1].append(first_difference(along(moments), q[i])[i])
    np.savez(
        output,
        rows=rows,
        parents=PARENTS,
        masses=masses,
        gravity=gravity,
        path_bodies=path_bodies,
        load_bodies=[b for b, *_ in loads],
        load_forces=[f for _, f, _, _ in loads],
        load_torques=[t for *_, t in loads],
        **{name: np.array(value) for name, value in result.items()},
    )


if __name__ == "__main__":
    main(int(sys.argv[1]), Path(sys.argv[2]))
