"""What OpenSim itself says, computed the slow way; run as a script because OpenSim needs its own process."""

import json
import sys

import numpy as np
import opensim


def run_static_optimization(question):
    """Run AnalyzeTool on a setup file, results into a folder, if asked with another criterion."""
    tool = opensim.AnalyzeTool(question["setup"])
    tool.setResultsDir(question["results"])
    if "criterion" in question:
        analysis = opensim.StaticOptimization.safeDownCast(tool.getModel().getAnalysisSet().get(0))
        analysis.setConvergenceCriterion(question["criterion"])
    tool.run()


def assembled(question):
    """Run AnalyzeTool on a setup file and return the coordinates in the poses that its analyses see."""
    tool = opensim.AnalyzeTool(question["setup"])
    model = tool.getModel()
    for i in range(model.getAnalysisSet().getSize()):
        model.getAnalysisSet().get(i).setOn(False)
    kinematics = opensim.Kinematics(model)
    kinematics.setInDegrees(False)
    model.addAnalysis(kinematics)
    tool.setPrintResultFiles(False)
    tool.run()
    storage = kinematics.getPositionStorage()
    labels = storage.getColumnLabels()
    values = []
    for name in question["coordinates"]:
        column = opensim.ArrayDouble()
        storage.getDataColumn(labels.findIndex(name) - 1, column)
        values.append(column.getAsVector().to_numpy())
    np.savez(question["output"], values=np.stack(values, axis=1))


def poses(question):
    """Yield model and state in every pose asked for, coupled coordinates following."""
    model = opensim.Model(question["model"])
    state = model.initSystem()
    coordinates, couplers = model.getCoordinateSet(), []
    constraints = model.getConstraintSet()
    for i in range(constraints.getSize()):
        coupler = opensim.CoordinateCouplerConstraint.safeDownCast(constraints.get(i))
        if coupler is not None:
            couplers.append(coupler)
    for values in question["values"]:
        for name, value in zip(question["coordinates"], values, strict=True):
            coordinates.get(name).setValue(state, value, False)
        for coupler in couplers:
            names = coupler.getIndependentCoordinateNames()
            independent = np.array(
                [coordinates.get(names.get(i)).getValue(state) for i in range(names.getSize())]
            )
            dependent = coupler.getFunction().calcValue(opensim.Vector.createFromMat(independent))
            coordinates.get(coupler.getDependentCoordinateName()).setValue(state, dependent, False)
        model.realizePosition(state)
        yield model, state


def moment_arms(question):
    """Compute every moment arm by OpenSim's own moment arm solver."""
    result = []
    for model, state in poses(question):
        coordinates = model.getCoordinateSet()
        muscles = [model.getMuscles().get(name) for name in question["muscles"]]
        result.append(
            [
                [muscle.getPath().computeMomentArm(state, coordinates.get(name)) for muscle in muscles]
                for name in question["coordinates"]
            ]
        )
    np.savez(question["output"], moment_arms=np.array(result))


def lengths(question):
    """Read the length of every path."""
    result = [
        [model.getMuscles().get(name).getPath().getLength(state) for name in question["muscles"]]
        for model, state in poses(question)
    ]
    np.savez(question["output"], lengths=np.array(result))


def weights(question):
    """Compute the generalized forces that hold the model still, all forces but gravity switched off."""
    result = []
    for model, state in poses(question):
        names = [
            name.removesuffix("/value").rsplit("/", 1)[-1]
            for name in opensim.createStateVariableNamesInSystemOrder(model)
            if name.endswith("/value")
        ]
        forces = model.getForceSet()
        for i in range(forces.getSize()):
            forces.get(i).setAppliesForce(state, False)
        model.realizeVelocity(state)
        still = opensim.Vector(len(names), 0.0)
        moments = opensim.InverseDynamicsSolver(model).solve(state, still).to_numpy()
        result.append([moments[names.index(name)] for name in question["coordinates"]])
    np.savez(question["output"], weights=np.array(result))


def storage(time, values):
    """Return an OpenSim table."""
    table, labels = opensim.Storage(), opensim.ArrayStr()
    for label in ("time", *(f"column{i}" for i in range(values.shape[1]))):
        labels.append(label)
    table.setColumnLabels(labels)
    for t, row in zip(time.tolist(), values, strict=True):
        table.append(t, opensim.Vector.createFromMat(np.ascontiguousarray(row)))
    return table


def columns(table, n_columns):
    """Return time and columns of an OpenSim table."""
    column = opensim.ArrayDouble()
    table.getTimeColumn(column)
    arrays = [column.getAsVector().to_numpy().copy()]
    for i in range(n_columns):
        table.getDataColumn(i, column)
        arrays.append(column.getAsVector().to_numpy().copy())
    return arrays[0], np.stack(arrays[1:], axis=1)


def prepared(question):
    """Filter columns and differentiate their splines twice, as AnalyzeTool does."""
    values = np.array(question["values"])
    table, n = storage(np.array(question["time"]), values), values.shape[1]
    if question["cutoff"] is not None:
        table.pad(table.getSize() // 2)
        table.lowpassIIR(question["cutoff"])
    time, values = columns(table, n)
    first = columns(opensim.GCVSplineSet(5, table).constructStorage(1), n)[1]
    second = columns(opensim.GCVSplineSet(5, storage(time, first)).constructStorage(1), n)[1]
    np.savez(question["output"], time=time, values=values, first=first, second=second)


def loads(question):
    """Read the forces of external loads at chosen times."""
    model = opensim.Model(question["model"])
    model.addModelComponent(own := opensim.ExternalLoads(question["loads"], True))
    own.this.disown()
    model.initSystem()
    forces = [[own.get(0).getForceAtTime(t).get(i) for i in range(3)] for t in question["time"]]
    np.savez(question["output"], forces=np.array(forces))


def carried(question):
    """Read what joints exert on their children, in ground, with given forces of muscles."""
    result = []
    for model, state in poses(question):
        muscles = model.getMuscles()
        for i in range(muscles.getSize()):
            muscles.get(i).overrideActuation(state, True)
            muscles.get(i).setOverrideActuation(state, question["forces"].get(muscles.get(i).getName(), 0.0))
        model.realizeAcceleration(state)
        joints = [model.getJointSet().get(name) for name in question["joints"]]
        both = [joint.calcReactionOnChildExpressedInGround(state) for joint in joints]
        result.append([[*one.get(1).to_numpy(), *one.get(0).to_numpy()] for one in both])
    np.savez(question["output"], reactions=np.array(result))


def main():
    """Answer the question given as JSON on the command line."""
    question = json.loads(sys.argv[1])
    opensim.Logger.setLevelString("Error")
    {
        "static optimization": run_static_optimization,
        "assembled": assembled,
        "moment arms": moment_arms,
        "lengths": lengths,
        "weights": weights,
        "prepared": prepared,
        "loads": loads,
        "carried": carried,
    }[question["kind"]](question)


if __name__ == "__main__":
    main()
